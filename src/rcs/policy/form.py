"""The form of actions: the columns of a policy's chunks as parts, and commands as actions of an environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from rcs.envs.env import Env
from rcs.envs.spaces import GRIPPER, HAND, JOINTS, TQUAT, TWIST, XYZRPY, Action, Observation
from rcs.errors import InvalidSetup
from rcs.policy.holding import flat, nested
from rcs.policy.offer import flat_boxes, key_of, unit_of
from rcs.policy.part import STILL, Array, Kind, Part
from rcs.policy.plan import NEAR, Command, Plan
from rcs.policy.units import from_unit
from rcs.spatial import limit_step

if TYPE_CHECKING:
    from vlagents import Metadata

CLIPPED = 1e-6
"""From which difference on a value counts as clipped."""

_KINDS: dict[str, Kind] = {
    JOINTS: "linear", HAND: "linear", TQUAT: "pose", XYZRPY: "rpy", GRIPPER: "opening", TWIST: "velocity",
}  # fmt: skip


class ActionForm:
    """Reads a policy's chunks, and writes an environment's actions."""

    def __init__(self, env: Env, metadata: Metadata) -> None:
        """Prepare for a policy that fits an environment.

        Raises:
            InvalidSetup: Nobody knows how to execute a part of the action.
        """
        self.parts = _parts(metadata)
        """What a chunk's columns are."""
        self._boxes = dict(flat_boxes(env.action_space))
        self._rate, self._horizon, self._size = metadata.rate, metadata.horizon, metadata.size
        self.is_clipped = False
        """Whether the policy wanted more than the environment takes, in the last action."""

    def start(self, observation: Observation, info: Mapping[str, Any], *, is_held: bool) -> dict[str, Array]:
        """Return where a chunk starts that is asked for now, by part: the last target, or what is measured.

        Args:
            observation: The present one.
            info: Of the last step; its `target` is where the robot will be.
            is_held: Whether the robot is held: then it goes nowhere.
        """
        measured, target = flat(observation), flat(info.get("target", {}))
        found: dict[str, Array] = {}
        for part in self.parts:
            if part.is_difference or part.kind in ("opening", "velocity"):
                continue
            key = part.name[: -len(XYZRPY)] + TQUAT if part.kind == "rpy" else part.name
            # What counts from the start counts from what the policy has seen.
            source = measured if part.counts_from_start or is_held else {**measured, **target}
            found[part.name] = np.array(source[key], np.float64)
        return found

    def in_flight(self, plan: Plan, now: float, start: Mapping[str, Array]) -> Array:
        """Return what a plan will do as rows of a chunk that begins now, (rows, size), for a policy with a rate."""
        rows: list[Array] = []
        while self._rate > 0 and len(rows) < self._horizon:
            command = plan.at(now + len(rows) / self._rate, 1.0 / self._rate)
            if command is None:
                break
            rows.append(np.concatenate([part.unread(command[part.name], start.get(part.name)) for part in self.parts]))
        return np.array(rows).reshape(len(rows), self._size)

    def frozen(self, delay: float, rows: int) -> int:
        """Return how many of the rows in flight will be executed within a delay [s]."""
        return min(int(np.ceil(delay * self._rate - NEAR)), rows)

    def bounded(self, command: Command) -> dict[str, Array]:
        """Return a command by part in the form of the action, inside the environment's bounds."""
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
        return values

    def action(self, values: Mapping[str, Array]) -> Action:
        """Return values by part as an action."""
        return nested(values, self._boxes)


def _parts(metadata: Metadata) -> list[Part]:
    parts: list[Part] = []
    first = 0
    for spec in metadata.action:
        kind = _KINDS.get(key_of(spec.name))
        if kind is None:
            raise InvalidSetup(f"Nobody knows how to execute the action {spec.name!r}; valid: {', '.join(_KINDS)}.")
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
