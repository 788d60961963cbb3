"""Stable-Baselines3's learners and policies, made from the records that are stored with checkpoints."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from gymnasium import spaces

from rcs.rl.algorithms import Algorithm, Dagger, Ppo, Rlpd, Sac
from rcs.rl.flat import Flat
from rcs.rl.packages import package
from rcs.rl.rlpd import rlpd_model, rlpd_replay
from rcs.rl.sb3 import Sb3VecEnv
from rcs.rl.student import make_student
from rcs.rl.training import Training

_FIRST_VALUES = 0.02
"""Factor on the weights of the first values: our choice; with it, PickCuboid reached the cuboid in half the steps."""
FEATURES_PER_CAMERA = 256
"""Numbers that the convolutions (Mnih et al. 2015) make of each frame; Stable-Baselines3's usual figure."""


def make_model(training: Training, envs: Sb3VecEnv) -> Any:
    """Return a learner of Stable-Baselines3, with its weights drawn from the training's seed.

    Raises:
        MissingDependency: torch or Stable-Baselines3 is not installed.
    """
    algorithm = training.algorithm
    assert not isinstance(algorithm, Dagger), "is made by TaughtLearner"
    has_images = isinstance(envs.observation_space, spaces.Dict)
    common: dict[str, Any] = {
        "policy": "MultiInputPolicy" if has_images else "MlpPolicy",
        "env": envs,
        "gamma": training.setup.discount,
        "learning_rate": _rate(algorithm),
        "batch_size": batch_size(training),
        "policy_kwargs": _network(algorithm, has_images=has_images),
        "seed": training.seed % 2**32,  # the range of NumPy's
        "device": training.device,
    }
    if isinstance(algorithm, Ppo):
        names = ("n_steps", "n_epochs", "gae_lambda", "clip_range", "ent_coef", "vf_coef", "max_grad_norm", "target_kl")
        model = _class(algorithm)(**common, **{name: getattr(algorithm, name) for name in names})
        # Otherwise they are noise of about 1, which hides what is paid far from an object for coming nearer.
        with package("torch").no_grad():
            model.policy.value_net.weight.mul_(_FIRST_VALUES)
        return model
    names = ("gradient_steps", "buffer_size", "learning_starts", "tau")
    common["ent_coef"] = "auto" if algorithm.ent_coef is None else algorithm.ent_coef
    if isinstance(algorithm, Rlpd):
        common["replay_buffer_class"] = rlpd_replay(has_images=has_images)
        common["replay_buffer_kwargs"] = {"teacher_rows": -(-algorithm.learning_starts // training.copies)}
    return _class(algorithm)(**common, **{name: getattr(algorithm, name) for name in names})


def batch_size(training: Training) -> int:
    """Return the steps per gradient step: those of the algorithm, or fewer, so that all batches are equally large."""
    algorithm = training.algorithm
    if not isinstance(algorithm, Ppo):
        return algorithm.batch_size
    steps = training.copies * algorithm.n_steps
    fewest = -(-steps // algorithm.batch_size)
    return steps // next(batches for batches in range(fewest, steps + 1) if steps % batches == 0)


def reward_scale(training: Training) -> float:
    """Return the factor on the rewards that a learner sees."""
    return training.algorithm.reward_scale if isinstance(training.algorithm, Ppo) else 1.0


def make_policy(algorithm: Algorithm, flat: Flat) -> Any:
    """Return the policy of an algorithm as a torch module on the CPU, with weights to be loaded.

    Raises:
        MissingDependency: torch or Stable-Baselines3 is not installed.
    """
    if isinstance(algorithm, Dagger):
        return make_student(algorithm, flat).eval()
    has_images = isinstance(flat.observation_space, spaces.Dict)
    kind = _class(algorithm).policy_aliases["MultiInputPolicy" if has_images else "MlpPolicy"]
    network = _network(algorithm, has_images=has_images)
    policy = kind(flat.observation_space, flat.action_space, lambda _: 0.0, **network)
    policy.set_training_mode(False)
    return policy


def mean_action(policy: Any) -> Callable[[Any], Any]:
    """Return the function from observations to a policy's mean actions, both as tensors with a leading axis.

    It is what the policy does without exploration, without the distributions that its own methods make on the way.
    """
    if hasattr(policy, "actor"):
        actor, torch = policy.actor, package("torch")
        return lambda observation: torch.tanh(actor.get_action_dist_params(observation)[0])
    if not hasattr(policy, "action_net"):
        return policy  # a student, which is that function
    return lambda observation: policy.action_net(
        policy.mlp_extractor.forward_actor(policy.extract_features(observation, policy.pi_features_extractor))
    )


def _class(algorithm: Ppo | Sac) -> Any:
    if isinstance(algorithm, Rlpd):
        return rlpd_model()
    sb3 = package("stable_baselines3")
    return sb3.PPO if isinstance(algorithm, Ppo) else sb3.SAC


def _network(algorithm: Ppo | Sac, *, has_images: bool) -> dict[str, Any]:
    nn = package("torch.nn")
    how: dict[str, Any] = {
        "net_arch": list(algorithm.network),
        "activation_fn": {"tanh": nn.Tanh, "relu": nn.ReLU}[algorithm.activation],
    }
    if isinstance(algorithm, Ppo):
        how["log_std_init"] = algorithm.log_std_init
        if algorithm.near_and_far and not has_images:
            how["features_extractor_class"] = _near_and_far()
    if has_images:
        how["features_extractor_kwargs"] = {"cnn_output_dim": FEATURES_PER_CAMERA}
    return how


@cache
def _near_and_far() -> Any:
    """Return the class of features that tell every number x twice, as 2 tanh(x / 2) and as tanh(4 x)."""
    torch = package("torch")
    base: Any = package("stable_baselines3.common.torch_layers").BaseFeaturesExtractor

    class NearAndFar(base):
        def __init__(self, space: spaces.Box) -> None:
            super().__init__(space, 2 * space.shape[0])

        def forward(self, observations: Any) -> Any:
            return torch.cat([2.0 * torch.tanh(0.5 * observations), torch.tanh(4.0 * observations)], -1)

    return NearAndFar


def _rate(algorithm: Ppo | Sac) -> Any:
    start = algorithm.learning_rate
    return start if algorithm.schedule == "constant" else lambda remaining: start * max(remaining, 0.0)
