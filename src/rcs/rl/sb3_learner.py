"""Learners of Stable-Baselines3, made from the records that are stored with checkpoints."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from rcs.envs.step.state import EnvState
from rcs.envs.vector import VecEnv
from rcs.rl.algorithms import Dagger, Ppo
from rcs.rl.flat import Flat
from rcs.rl.learner import Learner, env_state_of
from rcs.rl.networks import network_options
from rcs.rl.packages import package
from rcs.rl.sb3 import Sb3VecEnv
from rcs.rl.training import Training

_FIRST_VALUES = 0.02
"""Factor on the weights of the first values: our choice; with it, PickCuboid reached the cuboid in half the steps."""
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num", "_current_progress_remaining")
_REPLAYED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class Sb3Learner(Learner):
    """PPO or SAC of Stable-Baselines3."""

    def __init__(self, training: Training, envs: VecEnv | Sb3VecEnv, flat: Flat | None = None) -> None:
        """Make the learner and start an episode in every copy.

        Args:
            training: What is learned, from the first step on.
            envs: Copies of its environment, made with `autoreset="SameStep"`.
            flat: The maps of the policy; None for `Flat(envs)`.

        Raises:
            MissingDependency: torch or Stable-Baselines3 is not installed.
        """
        algorithm = training.algorithm
        scale = algorithm.reward_scale if isinstance(algorithm, Ppo) else 1.0
        vectors = Sb3VecEnv(envs, flat, reward_scale=scale) if isinstance(envs, VecEnv) else envs
        self.training, self.envs, self.flat, self._vectors = training, vectors.envs, vectors.flat, vectors
        model = self.model = make_model(training, vectors)
        """The learner of Stable-Baselines3."""
        self.policy = model.policy
        if algorithm.schedule == "linear":
            # Of the whole training: the library's own counts to the end of a call of `learn`.
            model.lr_schedule = lambda _: algorithm.learning_rate * max(1.0 - self.steps / training.steps, 0.0)
        model.set_logger(package("stable_baselines3.common.logger").Logger(folder=None, output_formats=[]))
        buffers = {} if isinstance(algorithm, Ppo) else {name: getattr(model.replay_buffer, name) for name in _REPLAYED}
        self.replay = {
            f"{name}/{key}" if key else name: rows
            for name, own in buffers.items()
            for key, rows in (own if isinstance(own, dict) else {"": own}).items()
        }
        vectors.seed(training.first_seed)
        self._resume(vectors.reset(), np.ones(training.copies, np.bool_), [], [])

    @property
    def steps(self) -> int:
        """Environment steps so far, of all copies together."""
        return int(self.model.num_timesteps)

    def advance(self) -> None:
        """Make the steps of one update, and the update."""
        algorithm = self.training.algorithm
        rows = algorithm.n_steps if isinstance(algorithm, Ppo) else 1
        self.model.learn(rows * self.training.copies, reset_num_timesteps=False, log_interval=None)

    def figures(self) -> dict[str, float]:
        """Return the figures of the updates since the last call, and of the last 100 episodes, by their SB3 names."""
        model = self.model
        logged: dict[str, Any] = model.logger.name_to_value
        figures = {name: float(value) for name, value in logged.items() if np.ndim(value) == 0}
        logged.clear()
        model.logger.name_to_count.clear()
        if episodes := list(model.ep_info_buffer):
            figures["rollout/ep_rew_mean"] = float(np.mean([episode["r"] for episode in episodes]))
            figures["rollout/ep_len_mean"] = float(np.mean([episode["l"] for episode in episodes]))
        if model.ep_success_buffer:
            figures["rollout/success_rate"] = float(np.mean(model.ep_success_buffer))
        return figures

    def state(self) -> dict[str, Any]:
        """Return everything but weights and replay: optimisers, counters, random numbers, episodes at work."""
        model, torch = self.model, package("torch")
        entropy = getattr(model, "log_ent_coef", None)
        return {
            "optimisers": {name: own for name, own in model.get_parameters().items() if name != "policy"},
            "entropy": None if entropy is None else entropy.detach().clone(),
            "counters": {name: getattr(model, name) for name in _COUNTERS},
            "observation": model._last_obs,
            "starts": model._last_episode_starts,
            "episodes": [dict(one) for one in model.ep_info_buffer],
            "successes": [bool(one) for one in model.ep_success_buffer],
            "random": {
                "python": random.getstate(),
                "numpy": np.random.get_state(),
                "torch": torch.get_rng_state(),
                "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
                "actions": model.action_space.np_random.bit_generator.state,
            },
            "environment": env_state_of(self.envs),
            "statistics": self._vectors.statistics(),
        }

    def _load(self, weights: Mapping[str, Any], state: Mapping[str, Any]) -> None:
        model, torch, drawn = self.model, package("torch"), state["random"]
        model.set_parameters({**state["optimisers"], "policy": weights})
        if state["entropy"] is not None:
            with torch.no_grad():
                model.log_ent_coef.copy_(state["entropy"])
        for name in _COUNTERS:
            setattr(model, name, state["counters"][name])
        self.envs.set_state(EnvState(**state["environment"]))
        self._vectors.set_statistics(state["statistics"])
        self._resume(*(state[name] for name in ("observation", "starts", "episodes", "successes")))
        if self.replay:
            buffer, rows = model.replay_buffer, self.steps // self.training.copies
            buffer.pos, buffer.full = rows % buffer.buffer_size, rows >= buffer.buffer_size
        random.setstate(drawn["python"])
        np.random.set_state(drawn["numpy"])
        torch.set_rng_state(drawn["torch"])
        if drawn["cuda"] and torch.cuda.is_available():
            torch.cuda.set_rng_state_all(drawn["cuda"])
        model.action_space.np_random.bit_generator.state = drawn["actions"]

    def _resume(self, observation: Any, starts: Any, episodes: Any, successes: Any) -> None:
        """Have the next steps continue from an observation, in place of a reset."""
        model = self.model
        model._last_obs, model._last_episode_starts = observation, starts
        model.ep_info_buffer = deque(episodes, model._stats_window_size)
        model.ep_success_buffer = deque(successes, model._stats_window_size)


def make_model(training: Training, envs: Sb3VecEnv) -> Any:
    """Return a learner of Stable-Baselines3, with its weights drawn from the training's seed.

    Raises:
        MissingDependency: torch or Stable-Baselines3 is not installed.
    """
    algorithm, sb3 = training.algorithm, package("stable_baselines3")
    assert not isinstance(algorithm, Dagger), "has a learner of its own"
    has_images = isinstance(envs.observation_space, spaces.Dict)
    options: dict[str, Any] = {
        "policy": "MultiInputPolicy" if has_images else "MlpPolicy",
        "env": envs,
        "gamma": training.setup.discount,
        "learning_rate": algorithm.learning_rate,
        "batch_size": batch_size(training),
        "policy_kwargs": network_options(algorithm, has_images=has_images),
        "seed": training.seed % 2**32,  # the range of NumPy's
        "device": training.device,
    }
    if isinstance(algorithm, Ppo):
        names = ("n_steps", "n_epochs", "gae_lambda", "clip_range", "ent_coef", "vf_coef", "max_grad_norm", "target_kl")
        model = sb3.PPO(**options, **{name: getattr(algorithm, name) for name in names})
        # Otherwise they are noise of about 1, which hides what is paid far from an object for coming nearer.
        with package("torch").no_grad():
            model.policy.value_net.weight.mul_(_FIRST_VALUES)
        return model
    options["ent_coef"] = "auto" if algorithm.ent_coef is None else algorithm.ent_coef
    names = ("gradient_steps", "buffer_size", "learning_starts", "tau")
    return sb3.SAC(**options, **{name: getattr(algorithm, name) for name in names})


def batch_size(training: Training) -> int:
    """Return the steps per gradient step: those of the algorithm, or fewer, so that all batches are equally large."""
    algorithm = training.algorithm
    if not isinstance(algorithm, Ppo):
        return algorithm.batch_size
    steps = training.copies * algorithm.n_steps
    fewest = -(-steps // algorithm.batch_size)
    return steps // next(batches for batches in range(fewest, steps + 1) if steps % batches == 0)
