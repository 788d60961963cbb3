"""A trained policy as an agent, in single environments and in batches."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.agents import Agent
from rcs.envs.spaces import Action, Observation
from rcs.errors import InvalidSetup
from rcs.rl.checkpoint import Checkpoint, find_checkpoint
from rcs.rl.flat import Flat
from rcs.rl.layout import FlatLayout
from rcs.rl.networks import make_policy, mean_action
from rcs.rl.packages import package


class PolicyAgent(Agent):
    """Acts by a trained policy, without exploration: what it is shown decides what it does.

    In a batch, every copy's observation goes through the network by itself: sums of a whole batch differ from those of
    one row in their last bits, and an episode would end otherwise than alone.
    """

    def __init__(self, mean: Callable[[Any], Any], layout: FlatLayout) -> None:
        """Take a policy.

        Args:
            mean: Returns the flat actions for flat observations, both as tensors on the CPU with a leading axis.
            layout: What the numbers of its vectors are.
        """
        self._mean = mean
        self._torch = package("torch")
        self.flat = Flat(layout)
        """The maps between dictionaries and the policy's vectors."""

    @classmethod
    def load(cls, path: str | Path | Checkpoint) -> PolicyAgent:
        """Return the agent of a checkpoint.

        Args:
            path: A checkpoint, its folder, or the folder of a run, of which the best one is taken.

        Raises:
            MissingDependency: torch or Stable-Baselines3 is not installed.
            InvalidSetup: There is no checkpoint, or another version of this program wrote it.
            CorruptCheckpoint: It is damaged.
        """
        checkpoint = path if isinstance(path, Checkpoint) else find_checkpoint(path)
        policy = make_policy(checkpoint.training.algorithm, Flat(checkpoint.layout))
        policy.load_state_dict(checkpoint.policy())
        return cls(mean_action(policy), checkpoint.layout)

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Check that the environment is one that the policy knows; nothing is remembered.

        Raises:
            InvalidSetup: An observation that it needs is missing, or has another shape.
        """
        try:
            self.flat.observation(observation)
        except InvalidSetup as err:
            raise InvalidSetup(
                f"The policy does not fit this environment: {err} `rcs eval CHECKPOINT` makes the right one."
            ) from err

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the action for an observation of one copy, or those of a batch."""
        flat = self.flat.observation(observation)
        example = next(iter(flat.values())) if isinstance(flat, dict) else flat
        space: Any = self.flat.observation_space
        own = next(iter(space.spaces.values())) if isinstance(flat, dict) else space
        if example.ndim == len(own.shape):
            return self.flat.action(self._row(flat))
        return self.flat.action(np.stack([self._row(_copy(flat, copy)) for copy in range(len(example))]))

    def _row(self, flat: Any) -> NDArray[np.float32]:
        torch = self._torch
        with torch.inference_mode():
            if isinstance(flat, dict):
                return self._mean({name: torch.from_numpy(rows[None]) for name, rows in flat.items()}).numpy()[0]
            return self._mean(torch.from_numpy(flat[None])).numpy()[0]


def _copy(flat: Any, copy: int) -> Any:
    return {name: rows[copy] for name, rows in flat.items()} if isinstance(flat, dict) else flat[copy]
