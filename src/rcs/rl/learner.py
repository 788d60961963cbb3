"""A learner between two updates: it goes on by one, and all that decides how it goes on can be read and set."""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from rcs.envs.step.state import EnvState
from rcs.errors import CorruptCheckpoint
from rcs.rl.algorithms import Rlpd, Sac
from rcs.rl.networks import make_model
from rcs.rl.packages import package
from rcs.rl.sb3 import Sb3VecEnv
from rcs.rl.teaching import teacher_for
from rcs.rl.training import Training


class Learner:
    """A learner of Stable-Baselines3 that makes one update at a time.

    What follows depends on `weights` and `state` (and, of an off-policy learner, on the rows of its replay) alone.
    """

    def __init__(self, training: Training, envs: Sb3VecEnv) -> None:
        """Make the learner and start an episode in every copy.

        Args:
            training: What is learned, from the first step on.
            envs: Copies of its environment.

        Raises:
            MissingDependency: torch or Stable-Baselines3 is not installed.
        """
        self.training = training
        self.envs = envs
        self.model = make_model(training, envs)
        """The learner, of Stable-Baselines3."""
        self.model.set_logger(package("stable_baselines3.common.logger").Logger(folder=None, output_formats=[]))
        if isinstance(training.algorithm, Rlpd):
            teacher = teacher_for(envs.envs, training.algorithm.teacher)
            self.model.teach = lambda: envs.flat.action_vector(teacher.act(envs.observation, {}))
        envs.seed(training.first_seed)
        # Starts the episodes and makes the buffers of statistics; without a callback, it returns one that does nothing.
        _, self._callback = self.model._setup_learn(training.steps, None, reset_num_timesteps=False)

    @property
    def policy(self) -> Any:
        """The policy, a torch module."""
        return self.model.policy

    @property
    def steps(self) -> int:
        """Environment steps so far, of all copies together."""
        return int(self.model.num_timesteps)

    @property
    def is_done(self) -> bool:
        """Whether all steps of the training were made."""
        return self.steps >= self.training.steps

    def advance(self) -> None:
        """Make the steps of one update, and the update."""
        model = self.model
        if isinstance(self.training.algorithm, Sac):
            model.collect_rollouts(
                model.env,
                train_freq=model.train_freq,
                callback=self._callback,
                learning_starts=model.learning_starts,
                replay_buffer=model.replay_buffer,
            )
            if model.num_timesteps > model.learning_starts:
                model.train(batch_size=model.batch_size, gradient_steps=model.gradient_steps)
            return
        model.collect_rollouts(model.env, self._callback, model.rollout_buffer, n_rollout_steps=model.n_steps)
        model._update_current_progress_remaining(model.num_timesteps, self.training.steps)
        model.train()

    @property
    def has_figures(self) -> bool:
        """Whether there are figures of an update that `figures` has not returned yet."""
        return bool(self.model.logger.name_to_value)

    def figures(self) -> dict[str, float]:
        """Return the figures of the last update and of the last 100 episodes, by name, and forget those of the update.

        The names are those of Stable-Baselines3.
        """
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

    # --- What decides how it goes on ----------------------------------------------------------------------------------

    def weights(self) -> dict[str, Any]:
        """Return the weights of the policy by name, as tensors."""
        return dict(self.model.policy.state_dict())

    def state(self) -> dict[str, Any]:
        """Return everything else but the replay: optimisers, counters, random numbers, episodes at work."""
        model = self.model
        modules, variables = model._get_torch_save_params()
        env = self.envs.envs.get_state()
        return {
            "optimisers": {name: _at(model, name).state_dict() for name in modules if name != "policy"},
            "variables": {name: _at(model, name).detach().clone() for name in variables},
            "counters": {name: getattr(model, name) for name in _COUNTERS},
            "observation": model._last_obs,
            "starts": model._last_episode_starts,
            "episodes": [dict(one) for one in model.ep_info_buffer],
            "successes": [bool(one) for one in model.ep_success_buffer],
            "random": _random_state(model.action_space),
            "environment": {own.name: getattr(env, own.name) for own in fields(env)},
            "statistics": self.envs.statistics(),
        }

    def load(self, weights: Mapping[str, Any], state: Mapping[str, Any]) -> None:
        """Go on from what `weights` and `state` returned.

        Raises:
            CorruptCheckpoint: They are of another learner.
            InvalidSetup: The state is that of another environment.
        """
        model, torch = self.model, package("torch")
        try:
            model.policy.load_state_dict(weights)
            for name, own in state["optimisers"].items():
                _at(model, name).load_state_dict(own)
            with torch.no_grad():
                for name, own in state["variables"].items():
                    _at(model, name).copy_(own)
            for name in _COUNTERS:
                setattr(model, name, state["counters"][name])
            self.envs.observation = self.envs.envs.set_state(EnvState(**state["environment"]))
            self.envs.set_statistics(state["statistics"])
            model._last_obs, model._last_episode_starts = state["observation"], state["starts"]
            for buffer, own in ((model.ep_info_buffer, "episodes"), (model.ep_success_buffer, "successes")):
                buffer.clear()
                buffer.extend(state[own])
            _set_random_state(model.action_space, state["random"])
        except (KeyError, TypeError, RuntimeError, AttributeError) as err:
            raise CorruptCheckpoint(f"The checkpoint is of another learner: {type(err).__name__}: {err}.") from err

    # --- Replay -------------------------------------------------------------------------------------------------------

    @property
    def has_replay(self) -> bool:
        """Whether it learns from transitions of long ago."""
        return isinstance(self.training.algorithm, Sac)

    def replay_piece(self, first: int) -> tuple[int, int, dict[str, Any]] | None:
        """Return what the replay took in since a row: first row, row after the last, and the rows; None for nothing.

        A row has a transition of each copy. Rows that were overwritten since are left out.
        """
        buffer = self.model.replay_buffer
        end = self.steps // self.training.copies
        first = max(first, end - buffer.buffer_size)
        if first >= end:
            return None
        where = np.arange(first, end) % buffer.buffer_size
        return first, end, {name: _taken(getattr(buffer, name), where) for name in _REPLAYED}

    def load_replay(self, pieces: Iterable[Mapping[str, Any]]) -> None:
        """Fill the replay with pieces that `replay_piece` returned, oldest first, the last one up to now.

        Raises:
            CorruptCheckpoint: They are of another learner.
        """
        buffer = self.model.replay_buffer
        given = list(pieces)
        end = self.steps // self.training.copies
        row = end - sum(len(piece["rewards"]) for piece in given)
        try:
            for piece in given:
                count = len(piece["rewards"])
                where = np.arange(row, row + count) % buffer.buffer_size
                for name in _REPLAYED:
                    _put(getattr(buffer, name), where, piece[name])
                row += count
        except (KeyError, TypeError, ValueError, IndexError) as err:
            raise CorruptCheckpoint(f"The replay is of another learner: {type(err).__name__}: {err}.") from err
        buffer.pos, buffer.full = end % buffer.buffer_size, end >= buffer.buffer_size


_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num", "_current_progress_remaining")
_REPLAYED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def _at(owner: Any, path: str) -> Any:
    for name in path.split("."):
        owner = getattr(owner, name)
    return owner


def _taken(rows: Any, where: Any) -> Any:
    return {name: own[where] for name, own in rows.items()} if isinstance(rows, dict) else rows[where]


def _put(rows: Any, where: Any, given: Any) -> None:
    if isinstance(rows, dict):
        for name, own in rows.items():
            own[where] = given[name]
    else:
        rows[where] = given


def _random_state(action_space: Any) -> dict[str, Any]:
    """Return the states of all generators that a learner draws from."""
    torch = package("torch")
    kind, keys, position, has_gauss, gauss = np.random.get_state()
    return {
        "python": random.getstate(),
        "numpy": (kind, keys, position, has_gauss, gauss),
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
        "actions": _plain(action_space.np_random.bit_generator.state),
    }


def _set_random_state(action_space: Any, state: Mapping[str, Any]) -> None:
    torch = package("torch")
    random.setstate(state["python"])
    np.random.set_state(state["numpy"])
    torch.set_rng_state(state["torch"])
    if state["cuda"] and torch.cuda.is_available():
        torch.cuda.set_rng_state_all(state["cuda"])
    action_space.np_random.bit_generator.state = state["actions"]


def _plain(value: Any) -> Any:
    return {name: _plain(own) for name, own in value.items()} if isinstance(value, dict) else value
