"""Actions of an environment from the chunks of a policy, and the action that holds the robot."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from rcs.envs.env import Env
from rcs.envs.spaces import GRIPPER, HAND, JOINTS, RAW, TQUAT, TWIST, XYZRPY, Action, Observation
from rcs.errors import DeviceFault, InvalidSetup
from rcs.policy.interface import flat, flat_boxes, from_unit, key_of, nested, unit_of
from rcs.policy.plan import STILL, Array, Command, Kind, Part
from rcs.spatial import limit_step, tquat_to_xyzrpy

if TYPE_CHECKING:
    from vlagents import Metadata

CLIPPED = 1e-6
"""From which difference on a value counts as clipped."""
NEARLY_OPEN = 0.95
"""Opening from which on a gripper holds nothing, 0 closed … 1 open."""

_KINDS: dict[str, Kind] = {
    JOINTS: "linear", HAND: "linear", TQUAT: "pose", XYZRPY: "rpy", GRIPPER: "opening", TWIST: "velocity",
    RAW: "opening",
}  # fmt: skip


class PolicyActions:
    """Converts between a policy's chunks and an environment's actions, in any control mode.

    To hold, the robot stays where it is measured when it begins to hold, and grippers keep their last command.
    Differences of nothing count from the measured state after `Env.hold`; absolute targets are the measured ones.
    """

    def __init__(self, env: Env, metadata: Metadata) -> None:
        """Prepare for a policy that fits an environment.

        Raises:
            InvalidSetup: A part of the action is of an unknown kind.
        """
        self.parts = parts_of(metadata)
        """The parts of a chunk's rows."""
        self._env = env
        self._boxes = dict(flat_boxes(env.action_space))
        self._is_absolute = env.setup.relative == "absolute"
        self.robot: str | None = None
        """The only robot that it leads; None for all."""
        self.is_clipped = False
        """True if the last action of the policy was beyond the bounds of the environment."""
        self._held: dict[str, Array] = {}
        self._grips: dict[str, Array] = {}
        self._was_moved = False

    @property
    def is_held(self) -> bool:
        """True while the robot holds."""
        return bool(self._held)

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin an episode, or begin anew in the midst of one.

        Grippers keep the last command to them, real ones also that of the episode before. Others are as they are
        measured, or open if they are not.

        Args:
            observation: The present one.
            info: The info of the reset, or of the last step, whose `target` has the last commands.
        """
        self._held, self._was_moved, self.is_clipped = {}, False, False
        known = {**flat(observation), **flat(info.get("target", {}))}
        names = [name for name in self._boxes if key_of(name) in (GRIPPER, HAND)]
        first = {name: known.get(name, np.ones(self._boxes[name].shape)) for name in names}
        self._grips = {name: self._grip(name, at) if self._is_real(name) else at for name, at in first.items()}

    def _is_real(self, name: str) -> bool:
        """Return whether a gripper or hand is a real device."""
        robot = name.rpartition("/")[0] or next(iter(self._env.robots), "")
        placement = self._env.robots.get(robot)
        effector = None if placement is None else placement.end_effector
        origin = "simulation" if effector is None else self._env.platform.get(f"{robot}/{effector.name}")
        return origin not in ("simulation", None)

    def _grip(self, name: str, measured: Array) -> Array:
        """Return with what a real gripper or hand begins: the last command to it, or where it is.

        One that only opens or closes fully stays closed unless it is open, for rounding would drop what it holds.
        """
        value = np.asarray(flat(self._env.stack.executed).get(name, measured), np.float64)
        is_rounded = key_of(name) == GRIPPER and self._env.setup.binary_gripper
        return (value >= NEARLY_OPEN).astype(np.float64) if is_rounded else value

    def start(self, observation: Observation, info: Mapping[str, Any]) -> dict[str, Array]:
        """Return where a chunk starts that is computed now, by part: the last target, or the measured state.

        Args:
            observation: The present one.
            info: The info of the last step; its `target` is where the robot will be, unless it holds.
        """
        measured, target = flat(observation), flat(info.get("target", {}))
        found: dict[str, Array] = {}
        for part in self.parts:
            if part.is_difference or part.kind in ("opening", "velocity"):
                continue
            key = part.name.removesuffix(XYZRPY) + TQUAT if part.kind == "rpy" else part.name
            # A part that counts from the start counts from the measured values.
            source = measured if part.counts_from_start or self.is_held else {**measured, **target}
            found[part.name] = np.array(source[key], np.float64)
        return found

    def action(self, command: Command) -> Action:
        """Return the action of a command, inside the environment's bounds."""
        values: dict[str, Array] = {}
        self.is_clipped = False
        for part in self.parts:
            box, value = self._boxes[part.name], part.write(command[part.name])
            wanted = value
            if part.is_pose and part.is_difference:
                turn = float(box.high[3]) if part.kind == "rpy" else 2 * float(np.arcsin(min(box.high[3], 1.0)))
                value = part.write(limit_step(STILL, command[part.name], np.inf, turn))
            values[part.name] = np.clip(value, box.low, box.high)
            self.is_clipped |= bool((np.abs(values[part.name] - wanted) > CLIPPED).any())
        self._held, self._was_moved = {}, True
        self._grips = {name: values[name] for name in self._grips}
        return nested(values, self._boxes)

    def hold(self, observation: Observation) -> Action:
        """Return the action of holding; the devices of the robots that it leads hold from its first one on."""
        if not self._held:
            measured = flat(observation)
            self._held = {name: self._place(name, measured) for name in self._boxes}
            self.is_clipped = False
            if self._was_moved and self.robot is None:
                self._env.hold()
            elif self._was_moved:  # the others go on, and their actions of this step count from where they did
                with contextlib.suppress(DeviceFault):  # of any robot; it ends the step, or has ended the episode
                    self._env.rebase(self.robot)
        return nested(self._held, self._boxes)

    def _place(self, name: str, measured: Mapping[str, Array]) -> Array:
        key = key_of(name)
        if self._is_absolute and key == XYZRPY:
            return tquat_to_xyzrpy(measured[name.removesuffix(XYZRPY) + TQUAT])
        if key in (GRIPPER, HAND):
            return self._grips[name]
        if self._is_absolute and key in (JOINTS, TQUAT):
            return measured[name]
        return STILL if key == TQUAT else np.zeros(self._boxes[name].shape)


def parts_of(metadata: Metadata) -> list[Part]:
    """Return the parts of an action that a policy announces, with their columns of a chunk.

    Raises:
        InvalidSetup: A part is of an unknown kind.
    """
    parts: list[Part] = []
    first = 0
    for spec in metadata.action:
        kind = _KINDS.get(key_of(spec.name))
        if kind is None:
            raise InvalidSetup(f"The action {spec.name!r} cannot be executed; valid: {', '.join(_KINDS)}.")
        scale, offset = from_unit(spec.unit, unit_of(spec.name)) or (1.0, 0.0)
        parts.append(
            Part(
                name=spec.name,
                columns=slice(first, first + spec.size),
                kind=kind,
                is_difference=spec.meaning == "delta",
                counts_from_start=spec.meaning == "relative",
                scale=scale,
                offset=0.0 if spec.meaning == "relative" else offset,
            )
        )
        first += spec.size
    return parts
