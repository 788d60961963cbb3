"""Learners make one update at a time, and their whole state can be saved and loaded; those of Stable-Baselines3."""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.step.state import EnvState
from rcs.envs.vector import VecEnv
from rcs.errors import CorruptCheckpoint
from rcs.extras import package_of
from rcs.rl.flat import Flat
from rcs.rl.networks import network_options
from rcs.rl.sb3 import Sb3VecEnv
from rcs.rl.training import Ppo, Training


class Learner(ABC):
    """Steps copies of an environment and updates a policy.

    Everything that follows depends on `weights`, `state` and the replay alone.
    """

    training: Training
    """The training."""
    envs: VecEnv
    """The copies."""
    flat: Flat
    """The maps of the policy."""
    policy: Any
    """The policy, a torch module."""
    replay: Mapping[str, NDArray[Any]]
    """Steps that are learned from later: arrays (rows, copies, ...) for the whole training. Empty for algorithms that
    learn from new steps alone."""

    @property
    @abstractmethod
    def steps(self) -> int:
        """Environment steps so far, of all copies together."""

    @property
    def is_done(self) -> bool:
        """True once all steps of the training are made."""
        return self.steps >= self.training.steps

    @abstractmethod
    def advance(self) -> None:
        """Make the steps of one update, and the update."""

    @abstractmethod
    def figures(self) -> dict[str, float]:
        """Return the figures of the updates since the last call, and of the last 100 episodes, by name."""

    def weights(self) -> dict[str, Any]:
        """Return the weights of the policy by name, as tensors."""
        return dict(self.policy.state_dict())

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """Return everything else but the replay: optimisers, counters, random numbers, running episodes."""

    def load(self, weights: Mapping[str, Any], state: Mapping[str, Any], replay: Iterable[Mapping[str, Any]]) -> None:
        """Continue from a saved state.

        Args:
            weights: Returned by `weights`.
            state: Returned by `state`.
            replay: All pieces that `replay_piece` returned, oldest first.

        Raises:
            CorruptCheckpoint: They are of another learner.
            InvalidSetup: The state is that of another environment.
        """
        try:
            self._load(weights, state)
            row = 0
            for piece in replay:
                count = len(next(iter(piece.values())))
                for name, rows in self.replay.items():
                    rows[row : row + count] = piece[name]
                row += count
        except (KeyError, TypeError, ValueError, IndexError, RuntimeError, AttributeError, StopIteration) as err:
            raise CorruptCheckpoint(f"The checkpoint is of another learner: {type(err).__name__}: {err}.") from err

    @abstractmethod
    def _load(self, weights: Mapping[str, Any], state: Mapping[str, Any]) -> None:
        """Continue from weights and state, without the replay."""

    def replay_piece(self, first: int) -> tuple[int, int, dict[str, NDArray[Any]]] | None:
        """Return new rows of the replay: number of the first, number after the last, and the rows; None for no rows.

        Args:
            first: The number of the first row that is wanted.
        """
        end = self.steps // self.training.copies
        if not self.replay or first >= end:
            return None
        return first, end, {name: rows[first:end] for name, rows in self.replay.items()}


_FIRST_VALUES = 0.02
"""Factor on the weights of the first values: our choice; with it, PickCuboid reached the cuboid in half the steps."""
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num", "_current_progress_remaining")


class Sb3Learner(Learner):
    """PPO of Stable-Baselines3."""

    def __init__(self, training: Training, envs: VecEnv | Sb3VecEnv) -> None:
        """Make the learner and start an episode in every copy.

        Args:
            training: The training, from the first step on.
            envs: Copies of its environment, made with `autoreset="SameStep"`.

        Raises:
            MissingDependency: torch or Stable-Baselines3 is not installed.
        """
        algorithm = training.algorithm
        assert isinstance(algorithm, Ppo), "others have learners of their own"
        vectors = Sb3VecEnv(envs, reward_scale=algorithm.reward_scale) if isinstance(envs, VecEnv) else envs
        self.training, self.envs, self.flat, self._vectors = training, vectors.envs, vectors.flat, vectors
        self.replay = {}
        model = self.model = make_model(training, algorithm, vectors)
        """The learner of Stable-Baselines3."""
        self.policy = model.policy
        if algorithm.schedule == "linear":
            # It spans the whole training; the library's own ends with a call of `learn`.
            model.lr_schedule = lambda _: algorithm.learning_rate * max(1.0 - self.steps / training.steps, 0.0)
        model.set_logger(package_of("rl", "stable_baselines3.common.logger").Logger(folder=None, output_formats=[]))
        vectors.seed(training.first_seed)
        self._resume(vectors.reset(), np.ones(training.copies, np.bool_), [], [])

    @property
    def steps(self) -> int:
        """Environment steps so far, of all copies together."""
        return int(self.model.num_timesteps)

    def advance(self) -> None:
        """Make the steps of one update, and the update."""
        self.model.learn(self.model.n_steps * self.training.copies, reset_num_timesteps=False, log_interval=None)

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
        """Return everything but weights and replay: optimisers, counters, random numbers, running episodes."""
        model, torch = self.model, package_of("rl", "torch")
        return {
            "optimisers": {name: own for name, own in model.get_parameters().items() if name != "policy"},
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
            "environment": vars(self.envs.get_state()),
            "statistics": {"returns": self._vectors.returns.copy(), "lengths": self._vectors.lengths.copy()},
        }

    def _load(self, weights: Mapping[str, Any], state: Mapping[str, Any]) -> None:
        model, torch, drawn = self.model, package_of("rl", "torch"), state["random"]
        model.set_parameters({**state["optimisers"], "policy": weights})
        for name in _COUNTERS:
            setattr(model, name, state["counters"][name])
        self.envs.set_state(EnvState(**state["environment"]))
        counted = state["statistics"]
        self._vectors.returns[:], self._vectors.lengths[:] = counted["returns"], counted["lengths"]
        self._resume(*(state[name] for name in ("observation", "starts", "episodes", "successes")))
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


def make_model(training: Training, algorithm: Ppo, envs: Sb3VecEnv) -> Any:
    """Return a learner of Stable-Baselines3, with its weights drawn from the training's seed.

    Raises:
        MissingDependency: torch or Stable-Baselines3 is not installed.
    """
    sb3 = package_of("rl", "stable_baselines3")
    has_images = isinstance(envs.observation_space, spaces.Dict)
    options: dict[str, Any] = {
        "policy": "MultiInputPolicy" if has_images else "MlpPolicy",
        "env": envs,
        "gamma": training.setup.discount,
        "learning_rate": algorithm.learning_rate,
        "batch_size": batch_size(algorithm, training.copies),
        "policy_kwargs": network_options(algorithm, has_images=has_images),
        "seed": training.seed % 2**32,  # the range of NumPy's
        "device": training.device,
    }
    names = ("n_steps", "n_epochs", "gae_lambda", "clip_range", "ent_coef", "vf_coef", "max_grad_norm", "target_kl")
    model = sb3.PPO(**options, **{name: getattr(algorithm, name) for name in names})
    # Otherwise they are noise of about 1, which hides what is paid far from an object for coming nearer.
    with package_of("rl", "torch").no_grad():
        model.policy.value_net.weight.mul_(_FIRST_VALUES)
    return model


def batch_size(algorithm: Ppo, copies: int) -> int:
    """Return the steps per gradient step: those of the algorithm, or fewer, so that all batches are equally large."""
    steps = copies * algorithm.n_steps
    fewest = -(-steps // algorithm.batch_size)
    return steps // next(batches for batches in range(fewest, steps + 1) if steps % batches == 0)
