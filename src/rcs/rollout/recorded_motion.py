"""An agent that has simulated robots follow the recorded motion of others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rcs.agents import Agent
from rcs.agents.agent import Action
from rcs.data import DatasetInfo, EpisodeRecord
from rcs.envs import spaces as keys
from rcs.envs.by_robot import by_robot, joined, prefixes
from rcs.envs.observers.recorder import EXECUTED, OBSERVATION
from rcs.envs.spaces import Observation
from rcs.errors import InvalidSetup
from rcs.sim.robot import SimRobot

GripperFrom = Literal["trend", "opening", "command"]
"""What a gripper is told: to open or close as its recorded opening does, that opening, or what it was told then."""

TREND = 0.1
"""An opening that has changed by this much since its last turn (of 1) opens or closes: more than a sensor's noise."""
GROWTH = 0.01
"""An opening that grows by more than this from row to row is opening."""
SQUEEZE = 0.15
"""An opening that does not grow is aimed this much below (of 1): fingers that were stopped by an object press on it."""
GRIPPER_LEAD = 0.07
"""So long after a command the opening shows it [s]: a step, and what a gripper needs for `TREND`."""
BARELY_CLOSED = 0.97
"""Above this a gripper counts as fully open and is not squeezed."""


class RecordedMotion(Agent):
    """Has the robots of an environment do what those of an episode did: one agent per episode."""

    def __init__(
        self,
        episode: EpisodeRecord,
        robots: list[SimRobot],
        gripper: GripperFrom,
        frequency: float,
        lookahead: float | None = None,
        state: str | None = None,
    ) -> None:
        """Read the states.

        Args:
            episode: The episode.
            robots: The simulated robots that are to follow.
            gripper: What their grippers are told.
            frequency: Control steps per second of the simulation [Hz].
            lookahead: By how much joint targets run ahead of the recording [s]; None for as much as each servo lags.
            state: The feature that has joints, then gripper or hand, robot by robot; None for a feature each.

        Raises:
            InvalidSetup: The dataset lacks a feature, or it has another shape than these robots.
            CorruptEpisode: The episode is damaged.
        """
        if episode.length < 2:
            raise InvalidSetup(f"Episode {episode.id!r} has {episode.length} rows; a motion has at least 2.")
        places = find_states(episode.info, robots, gripper, state)
        columns = {feature: episode.column(feature).astype(np.float64) for feature, _ in places.values()}
        values = {key: columns[feature][:, part] for key, (feature, part) in places.items()}
        self._times: NDArray[np.float64] = np.arange(episode.length) / episode.info.frequency
        self._frequency = frequency
        self._steps = 0
        before = prefixes(robot.placement.name for robot in robots)
        self._robots = {
            name: _Robot(values, robot, prefix, gripper, lookahead)
            for robot, (name, prefix) in zip(robots, before.items(), strict=True)
        }

    @property
    def duration(self) -> float:
        """How long the recording is [s]."""
        return float(self._times[-1])

    def start(self) -> dict[str, Any]:
        """Return how the robots stood at the start, for `Env.reset`."""
        return joined({name: robot.start for name, robot in self._robots.items()})

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Go back to the start."""
        self._steps = 0

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return what has the robots be, at the end of the next step, where they were recorded at that time.

        Returns:
            Absolute joint targets, and what grippers or hands are told.
        """
        self._steps += 1
        time, period = self._steps / self._frequency, 1 / self._frequency
        return joined({name: robot.target(time, period, self._times) for name, robot in self._robots.items()})

    def error(self, observation: Observation, time: float) -> float:
        """Return the largest distance of a joint from where it was recorded at a time since the start [rad]."""
        errors = [
            np.abs(part[keys.JOINTS] - _interpolated(self._robots[name].joints, time, self._times)).max()
            for name, part in by_robot(self._robots, observation).items()
        ]
        return float(max(errors))


class _Robot:
    """The recorded states of one robot, and what its simulated twin is told."""

    def __init__(
        self,
        values: dict[str, NDArray[np.float64]],
        robot: SimRobot,
        prefix: str,
        gripper: GripperFrom,
        lookahead: float | None,
    ) -> None:
        self._lag = robot.servo_lag
        self._lookahead = lookahead
        self._lead = 0.0 if gripper == "command" else GRIPPER_LEAD
        self._is_stepwise = gripper != "opening"
        self._box = keys.joints_space(robot.placement.arm.joint_lower, robot.placement.arm.joint_upper)
        self.joints = values[f"{OBSERVATION}/{prefix}{keys.JOINTS}"]
        self.start: dict[str, NDArray[Any]] = {keys.JOINTS: self.joints[0]}
        self._fingers: dict[str, NDArray[np.float64]] = {}
        for key, has in ((keys.GRIPPER, robot.placement.gripper), (keys.HAND, robot.placement.hand)):
            if has is None:
                continue
            measured = np.clip(values[f"{OBSERVATION}/{prefix}{key}"], 0.0, 1.0)
            self.start[key] = measured[0]
            if gripper == "command":
                told = values[f"{EXECUTED}/{prefix}{key}"]
                self._fingers[key] = np.concatenate([told[1:2], told[1:]])  # nothing was told before the first step
            elif gripper == "trend":
                # A hand that only opens and grasps is told so under the gripper's key too.
                self._fingers[keys.GRIPPER] = trend(values[f"{OBSERVATION}/{prefix}{keys.GRIPPER}"])
            else:
                self._fingers[key] = squeezed(measured) if key == keys.GRIPPER else measured

    def target(self, time: float, period: float, times: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
        # A target is held for a whole period, so that at the end of it half of one is made up already.
        ahead = np.maximum(self._lag - period / 2, 0.0) if self._lookahead is None else self._lookahead
        at = time + np.broadcast_to(ahead, self._lag.shape)
        joints = np.array([np.interp(at[i], times, self.joints[:, i]) for i in range(len(at))])
        action: dict[str, NDArray[Any]] = {keys.JOINTS: np.clip(joints, self._box.low, self._box.high)}
        when = time + self._lead
        for key, told in self._fingers.items():
            value = told[_row(when, times)] if self._is_stepwise else _interpolated(told, when, times)
            action[key] = np.clip(value, 0.0, 1.0).astype(np.float32)
        return action


def find_states(
    info: DatasetInfo, robots: list[SimRobot], gripper: GripperFrom, state: str | None = None
) -> dict[str, tuple[str, slice]]:
    """Return where a dataset has what a motion is made of: feature and place in it, by the key that this has here.

    Args:
        info: What the dataset has.
        robots: The robots that are to follow.
        gripper: What their grippers are told.
        state: The feature that has joints, then gripper or hand, robot by robot; None for a feature each.

    Raises:
        InvalidSetup: A feature is missing or has another shape than the robots.
    """
    sizes: dict[str, int] = {}
    apart: dict[str, int] = {}  # what is never joined to the others
    before = prefixes(robot.placement.name for robot in robots).values()
    for placement, prefix in zip([robot.placement for robot in robots], before, strict=True):
        sizes[f"{OBSERVATION}/{prefix}{keys.JOINTS}"] = len(placement.arm.joints)
        parts = {keys.GRIPPER: 1} if placement.gripper is not None else {}
        if placement.hand is not None:
            parts[keys.HAND] = len(placement.hand.joints)
            if gripper == "trend":
                apart[f"{OBSERVATION}/{prefix}{keys.GRIPPER}"] = 1  # a hand that only opens and grasps has it too
        for key, size in parts.items():
            sizes[f"{OBSERVATION}/{prefix}{key}"] = size
            if gripper == "command":
                apart[f"{EXECUTED}/{prefix}{key}"] = size
    places = {key: (key, slice(0, size)) for key, size in {**sizes, **apart}.items()}
    needed = {key: (size,) for key, size in {**sizes, **apart}.items()}
    if state is not None:
        ends = np.cumsum(list(sizes.values())).tolist()
        places |= {key: (state, slice(end - size, end)) for (key, size), end in zip(sizes.items(), ends, strict=True)}
        needed = {state: (ends[-1],), **{key: (size,) for key, size in apart.items()}}
    shapes = {feature.key: feature.shape for feature in info.features}
    wrong = {key: shape for key, shape in needed.items() if shapes.get(key) != shape}
    if wrong:
        found = {key: shape for key, shape in shapes.items() if key.startswith((OBSERVATION, EXECUTED))}
        names = ", ".join(robot.placement.name for robot in robots)
        raise InvalidSetup(f"To follow the recording, {names} needs the features {wrong}; there are {found}.")
    return places


def trend(openings: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return 1 where a gripper is open or opens and 0 where it is closed or closes.

    Args:
        openings: Measured openings, 0 closed … 1 open, (rows, 1).

    Returns:
        The same shape: it changes in the row in which the opening has turned by more than `TREND`.
    """
    told = np.empty(openings.shape, np.float64)
    is_open = bool(openings[0, 0] >= 0.5)
    # Medians of three rows: one that is far off tells nothing, and a step stays a step.
    padded = np.concatenate([openings[:1, 0], openings[:, 0], openings[-1:, 0]])
    medians = np.median(np.stack([padded[:-2], padded[1:-1], padded[2:]]), axis=0)
    turn = float(medians[0])  # the largest opening since it began to open, or the smallest since it began to close
    for i, opening in enumerate(medians):
        turn = max(turn, float(opening)) if is_open else min(turn, float(opening))
        if abs(opening - turn) > TREND:
            is_open, turn = not is_open, float(opening)
        told[i] = float(is_open)
    return told


def squeezed(openings: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return openings to aim at, so that fingers which were stopped by an object press on it.

    Args:
        openings: Measured openings, 0 closed … 1 open, (rows, 1).
    """
    grows = np.diff(openings, axis=0, append=openings[-1:]) > GROWTH
    return np.where(grows | (openings > BARELY_CLOSED), openings, np.maximum(openings - SQUEEZE, 0.0))


def _interpolated(values: NDArray[np.float64], time: float, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values (rows, n) at a time, on a line between rows; before the first and after the last, those."""
    i = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
    part = float(np.clip((time - times[i]) / (times[i + 1] - times[i]), 0.0, 1.0))
    return values[i] + part * (values[i + 1] - values[i])


def _row(time: float, times: NDArray[np.float64]) -> int:
    """Return the row that is nearest to a time."""
    return int(np.clip(round(time / float(times[1])), 0, len(times) - 1))
