"""A trained policy as an agent, in single environments and in batches."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.agents import Agent
from rcs.agents.identity import Identity
from rcs.envs.env import Env
from rcs.envs.spaces import Action, Observation
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup
from rcs.extras import package_of
from rcs.rl.checkpoint import POLICY, Checkpoint, find_checkpoint
from rcs.rl.flat import Flat
from rcs.rl.layout import FlatLayout
from rcs.rl.networks import make_policy, mean_action

_MEANING = ("robot", "end_effector", "control", "relative", "binary_gripper", "frequency")


class PolicyAgent(Agent):
    """Acts by a trained policy without exploration; its actions depend on the observation alone.

    In a batch, every copy's observation goes through the network by itself: sums of a whole batch differ from those of
    one row in their last bits, and an episode would end otherwise than alone.
    """

    def __init__(
        self, mean: Callable[[Any], Any], layout: FlatLayout, weights: str | None = None, *, rate: float | None = None
    ) -> None:
        """Take a policy.

        Args:
            mean: Returns the flat actions for flat observations, both as tensors on the CPU with a leading axis.
            layout: The layout of its vectors.
            weights: SHA-256 of the file of its weights; None while it is trained.
            rate: Rate of its decisions [Hz]; None for once per step.
        """
        self.rate = rate
        self._mean = mean
        self._weights = weights
        self._torch = package_of("rl", "torch")
        self.flat = Flat(layout)
        """The maps between dictionaries and the policy's vectors."""

    @classmethod
    def load(cls, path: str | Path | Checkpoint, env: Env | VecEnv | None = None) -> PolicyAgent:
        """Return the agent of a checkpoint.

        Args:
            path: A checkpoint, its folder, or the folder of a run, of which the best one is taken.
            env: Where the agent is to act; None to check that later.

        Raises:
            MissingDependency: torch or Stable-Baselines3 is not installed.
            InvalidSetup: There is no checkpoint, another version of this program wrote it, or the environment has
                another robot, or takes actions in another way, than that of the training. A single one may have a
                higher frequency, such as for a person who takes over.
            CorruptCheckpoint: It is damaged.
        """
        checkpoint = path if isinstance(path, Checkpoint) else find_checkpoint(path)
        if env is not None:
            _require_alike(checkpoint, env)
        trained = checkpoint.training.setup.frequency
        rate = trained if isinstance(env, Env) and env.frequency != trained else None
        policy = make_policy(checkpoint.training.algorithm, Flat(checkpoint.layout))
        policy.load_state_dict(checkpoint.policy())
        return cls(mean_action(policy), checkpoint.layout, checkpoint.files[POLICY], rate=rate)

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Check that the environment has what the policy observes.

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
        example = next(iter(flat.values())) if isinstance(flat, dict) else flat  # the state, or without one a frame
        before = self._torch.get_num_threads()
        self._torch.set_num_threads(1)  # a row is small, and sums are then the same in every process
        try:
            if example.ndim == (1 if self.flat.layout.state else 3):
                return self.flat.action(self._row(flat))
            return self.flat.action(np.stack([self._row(_copy(flat, copy)) for copy in range(len(example))]))
        finally:
            self._torch.set_num_threads(before)

    @property
    def weights(self) -> str | None:
        """SHA-256 of the file of the weights."""
        return self._weights

    def _row(self, flat: Any) -> NDArray[np.float32]:
        torch = self._torch
        with torch.inference_mode():
            if isinstance(flat, dict):
                return self._mean({name: torch.tensor(rows[None]) for name, rows in flat.items()}).numpy()[0]
            return self._mean(torch.from_numpy(flat[None])).numpy()[0]


@dataclass(frozen=True)
class TrainedPolicy:
    """The policy at a path. Called with an environment, it makes an agent."""

    path: str
    """A checkpoint's folder, or that of a run, of which the best checkpoint is taken."""

    def identify(self) -> Identity:
        """Return run and steps as the name, such as `pick@40000`, and the hash of the weights.

        Raises:
            InvalidSetup: There is no checkpoint, or another version of this program wrote it.
            CorruptCheckpoint: It is damaged.
        """
        checkpoint = find_checkpoint(self.path)
        run = checkpoint.path.resolve().parent.parent.name
        return Identity(
            name=f"{run}@{checkpoint.steps}",
            weights=checkpoint.files[POLICY],
            trained=checkpoint.steps,
            place=str(checkpoint.path),
        )

    def __call__(self, env: Env) -> PolicyAgent:
        """Return an agent; raises as `PolicyAgent.load` does."""
        return PolicyAgent.load(self.path, env)


def _require_alike(checkpoint: Checkpoint, env: Env | VecEnv) -> None:
    """Check that actions mean in an environment what they meant in training."""
    trained, here = checkpoint.training.setup, env.setup
    different = [name for name in _MEANING if getattr(trained, name) != getattr(here, name)]
    if isinstance(env, Env) and here.frequency > trained.frequency:  # it decides at its own rate
        different.remove("frequency")
    if different:
        words = "; ".join(f"{name} is {getattr(here, name)!r}, not {getattr(trained, name)!r}" for name in different)
        raise InvalidSetup(
            f"The policy of {checkpoint.path} was trained in another environment: {words}. `rcs eval CHECKPOINT` makes "
            "the right one."
        )


def _copy(flat: Any, copy: int) -> Any:
    return {name: rows[copy] for name, rows in flat.items()} if isinstance(flat, dict) else flat[copy]
