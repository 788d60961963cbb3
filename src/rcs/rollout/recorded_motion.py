"""An agent that makes simulated robots follow a recorded motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rcs_data import DatasetInfo, EpisodeRecord

from rcs.agents import Agent
from rcs.envs import spaces as keys
from rcs.envs.observers.dataset_info import OBSERVATION
from rcs.envs.spaces import Action, Observation, join_robots, robot_prefixes, split_by_robot
from rcs.errors import InvalidSetup
from rcs.sim.robot import SimRobot

THRESHOLD = 0.1
"""Change of an opening since its last turn that counts as opening or closing (of 1): above a sensor's noise."""
GROWTH = 0.01
"""Growth of an opening from row to row that counts as opening."""
SQUEEZE = 0.15
"""How far to aim below an opening that does not grow (of 1), so that fingers press on an object that stopped them."""
GRIPPER_LEAD = 0.07
"""Delay from a command to its effect on the opening [s]: a step, and the time to change by `THRESHOLD`."""
BARELY_CLOSED = 0.97
"""Opening above which a gripper counts as fully open and is not closed further."""


class RecordedMotion(Agent):
    """Makes the robots of an environment follow those of an episode; one agent per episode.

    A gripper or hand that only opens and closes follows the trend of the recorded opening, another one that opening.
    """

    def __init__(self, episode: EpisodeRecord, robots: list[SimRobot], is_binary: bool, frequency: float) -> None:
        """Read the states.

        Args:
            episode: The episode.
            robots: The simulated robots.
            is_binary: Whether their grippers only open and close fully.
            frequency: Control steps per second of the simulation [Hz].

        Raises:
            InvalidSetup: A feature is missing or does not fit these robots.
            CorruptEpisode: The episode is damaged.
        """
        if episode.length < 2:
            raise InvalidSetup(f"Episode {episode.id!r} has {episode.length} rows; a motion needs at least 2.")
        values = {key: episode.column(key).astype(np.float64) for key in find_states(episode.info, robots, is_binary)}
        self._times: NDArray[np.float64] = np.arange(episode.length) / episode.info.frequency
        self._frequency = frequency
        self._steps = 0
        before = robot_prefixes(robot.placement.name for robot in robots)
        self._robots = {
            name: _Robot(values, robot, f"{OBSERVATION}/{prefix}", is_binary)
            for robot, (name, prefix) in zip(robots, before.items(), strict=True)
        }

    @property
    def duration(self) -> float:
        """Duration of the recording [s]."""
        return float(self._times[-1])

    def start(self) -> dict[str, Any]:
        """Return the state of the robots at the start, for `Env.reset`."""
        return join_robots({name: robot.start for name, robot in self._robots.items()})

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Go back to the start."""
        self._steps = 0

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the action that takes the robots to their recorded positions at the end of the next step.

        Returns:
            Absolute joint targets, and commands of grippers or hands.
        """
        self._steps += 1
        time = self._steps / self._frequency
        return join_robots({name: robot.action(time, self._times) for name, robot in self._robots.items()})

    def error(self, observation: Observation, time: float) -> float:
        """Return the largest distance of a joint from its recorded position at a time since the start [rad]."""
        errors = [
            np.abs(part[keys.JOINTS] - _interpolated(self._robots[name].joints, time, self._times)).max()
            for name, part in split_by_robot(self._robots, observation).items()
        ]
        return float(max(errors))


class _Robot:
    """The recorded states of one robot."""

    def __init__(self, values: dict[str, NDArray[np.float64]], robot: SimRobot, prefix: str, is_binary: bool) -> None:
        self._is_binary = is_binary
        self._box = keys.joints_space(robot.placement.arm.joint_lower, robot.placement.arm.joint_upper)
        self.joints = values[f"{prefix}{keys.JOINTS}"]
        self.start: dict[str, NDArray[Any]] = {keys.JOINTS: self.joints[0]}
        self._fingers: dict[str, NDArray[np.float64]] = {}
        for key, has in ((keys.GRIPPER, robot.placement.gripper), (keys.HAND, robot.placement.hand)):
            if has is None:
                continue
            measured = np.clip(values[f"{prefix}{key}"], 0.0, 1.0)
            self.start[key] = measured[0]
            if is_binary:  # a hand that only opens and grasps is commanded under the gripper's key
                self._fingers[keys.GRIPPER] = trend(values[f"{prefix}{keys.GRIPPER}"])
            else:
                self._fingers[key] = squeezed(measured) if key == keys.GRIPPER else measured

    def action(self, time: float, times: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
        joints = _interpolated(self.joints, time, times)
        action: dict[str, NDArray[Any]] = {keys.JOINTS: np.clip(joints, self._box.low, self._box.high)}
        ahead = time + GRIPPER_LEAD
        for key, openings in self._fingers.items():
            value = openings[_row(ahead, times)] if self._is_binary else _interpolated(openings, ahead, times)
            action[key] = np.clip(value, 0.0, 1.0).astype(np.float32)
        return action


def find_states(info: DatasetInfo, robots: list[SimRobot], is_binary: bool) -> list[str]:
    """Return the features of a motion.

    Args:
        info: The info of the dataset.
        robots: The robots that are to follow.
        is_binary: Whether their grippers only open and close fully.

    Raises:
        InvalidSetup: A feature is missing or does not fit the robots.
    """
    needed: dict[str, tuple[int, ...]] = {}
    before = robot_prefixes(robot.placement.name for robot in robots).values()
    for placement, prefix in zip([robot.placement for robot in robots], before, strict=True):
        needed[f"{OBSERVATION}/{prefix}{keys.JOINTS}"] = (len(placement.arm.joints),)
        if placement.hand is not None:
            needed[f"{OBSERVATION}/{prefix}{keys.HAND}"] = (len(placement.hand.joints),)
        if placement.gripper is not None or (placement.hand is not None and is_binary):
            needed[f"{OBSERVATION}/{prefix}{keys.GRIPPER}"] = (1,)
    shapes = {feature.key: feature.shape for feature in info.features}
    wrong = {key: shape for key, shape in needed.items() if shapes.get(key) != shape}
    if wrong:
        found = {key: shape for key, shape in shapes.items() if key.startswith(OBSERVATION)}
        names = ", ".join(robot.placement.name for robot in robots)
        raise InvalidSetup(f"To follow the recording, {names} needs the features {wrong}; the dataset has {found}.")
    return list(needed)


def trend(openings: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return 1 where a gripper is open or opening and 0 where it is closed or closing.

    Args:
        openings: Measured openings, 0 closed … 1 open, (rows, 1).

    Returns:
        The same shape; it changes in the row where the opening has turned by more than `THRESHOLD`.
    """
    commands = np.empty(openings.shape, np.float64)
    is_open = bool(openings[0, 0] >= 0.5)
    # Medians of three rows remove single outliers and preserve steps.
    padded = np.concatenate([openings[:1, 0], openings[:, 0], openings[-1:, 0]])
    medians = np.median(np.stack([padded[:-2], padded[1:-1], padded[2:]]), axis=0)
    extreme = float(medians[0])  # since the last turn
    for i, opening in enumerate(medians):
        extreme = max(extreme, float(opening)) if is_open else min(extreme, float(opening))
        if abs(opening - extreme) > THRESHOLD:
            is_open, extreme = not is_open, float(opening)
        commands[i] = float(is_open)
    return commands


def squeezed(openings: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return openings to aim at, so that fingers stopped by an object press on it.

    Args:
        openings: Measured openings, 0 closed … 1 open, (rows, 1).
    """
    grows = np.diff(openings, axis=0, append=openings[-1:]) > GROWTH
    return np.where(grows | (openings > BARELY_CLOSED), openings, np.maximum(openings - SQUEEZE, 0.0))


def _interpolated(values: NDArray[np.float64], time: float, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values (rows, n) at a time, interpolated linearly and clamped to the first and last row."""
    i = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
    part = float(np.clip((time - times[i]) / (times[i + 1] - times[i]), 0.0, 1.0))
    return values[i] + part * (values[i + 1] - values[i])


def _row(time: float, times: NDArray[np.float64]) -> int:
    """Return the row that is nearest to a time."""
    return int(np.clip(round(time / float(times[1])), 0, len(times) - 1))
