"""The interface of learners: they make one update at a time, and their whole state can be saved and loaded."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.step.state import EnvState
from rcs.envs.vector import VecEnv
from rcs.errors import CorruptCheckpoint
from rcs.rl.flat import Flat
from rcs.rl.training import Training


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
    """Transitions that are learned from later: arrays (rows, copies, ...), which begin anew when they are full. Empty
    for algorithms that learn from new steps alone."""

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
        """Return everything else but the replay: optimisers, counters, random numbers, episodes at work."""

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
            row, pieces = self.steps // self.training.copies, list(replay)
            row -= sum(len(next(iter(piece.values()))) for piece in pieces)
            for piece in pieces:
                count = len(next(iter(piece.values())))
                for name, rows in self.replay.items():
                    rows[np.arange(row, row + count) % len(rows)] = piece[name]
                row += count
        except (KeyError, TypeError, ValueError, IndexError, RuntimeError, AttributeError, StopIteration) as err:
            raise CorruptCheckpoint(f"The checkpoint is of another learner: {type(err).__name__}: {err}.") from err

    @abstractmethod
    def _load(self, weights: Mapping[str, Any], state: Mapping[str, Any]) -> None:
        """Continue from weights and state, without the replay."""

    def replay_piece(self, first: int) -> tuple[int, int, dict[str, NDArray[Any]]] | None:
        """Return new rows of the replay: number of the first, number after the last, and the rows; None for no rows.

        Args:
            first: The number of the first row that is wanted. Rows that were overwritten since are left out.
        """
        end = self.steps // self.training.copies
        first = max(first, end - min(map(len, self.replay.values()), default=0))
        if first >= end:
            return None
        return first, end, {name: rows[np.arange(first, end) % len(rows)] for name, rows in self.replay.items()}


def env_state_of(envs: VecEnv) -> dict[str, Any]:
    """Return the state of all copies, by the names of its fields."""
    state = envs.get_state()
    return {own.name: getattr(state, own.name) for own in fields(EnvState)}
