"""A guard: no target reaches a device whose way there comes too near to anything.

What is checked is the way, not its end: from what was commanded last to the target and on to where the arm could stop,
and from where the arm is measured to the target, for all robots at once, in steps of at most 2 mm and 0.5 degrees (in
C++). Where a robot stands too near already, it may move along and away, but no nearer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rcs._core import CollisionChecker
from rcs.envs.gate import Gate
from rcs.envs.guarded_scene import Box, GuardedScene
from rcs.envs.layers.layer import Where
from rcs.envs.spaces import GRIPPER, HAND, JOINTS, Action, Observation
from rcs.errors import InvalidSetup, Refused
from rcs.sim.scene import Scene

if TYPE_CHECKING:
    from rcs.envs.parts import Parts
    from rcs.sim.world import World

OnHit = Literal["reject", "clip", "stop"]
"""What follows when the way is not free: all devices hold; all robots go the last safe part of their way; all devices
hold and the episode ends."""

STEP = 0.002
"""No point of a robot moves by more than this between two checks of what is near [m]."""
TURN = math.radians(0.5)
"""And nothing turns by more than this [rad]."""

DEADLINE = 0.01
"""Longest time that a check may take in real time [s]."""

SLACK = 1e-5
"""By how much the distance to what is too near already may shrink: rounding of distances [m]."""

SAFE = 1e-3
"""Part of a way that is left out before a hit, for rounding."""

SAME = 1e-4
"""An arm that is measured this close to where it was commanded stands there [rad]: at 1 m these are 0.1 mm."""

FRACTION = "guard_fraction"
"""Key of `info`: the part of the way that was admitted, 1 for all of it."""


class Guard(Gate):
    """Checks the way of all robots to their targets before any device sees them."""

    memory = ("_commanded",)

    def __init__(
        self,
        *,
        on_hit: OnHit = "reject",
        margin: float = 0.01,
        near_margin: float = 0.001,
        near: Sequence[str] | None = None,
        touch: Sequence[str] | None = None,
        allow: Sequence[Sequence[str]] = (),
        workspace: Box | None = None,
        deadline: float | None = None,
    ) -> None:
        """Choose what is kept apart.

        Args:
            on_hit: What follows when a way is not free. Copies of a batch are cut one by one, which is `clip`.
            margin: Distance that robots keep from themselves, each other and everything else [m].
            near_margin: Distance that end effectors keep from the bodies in `near`, and links of a robot from each
                other that are close by construction [m].
            near: Bodies that work brings end effectors close to; None for the table, if there is one.
            touch: Bodies that end effectors may touch; None for the task's objects.
            allow: More bodies that may touch, in pairs of names, such as `[["fr3/gripper/hand", "fixture"]]`.
            workspace: Lowest and highest corner [m] in the frame of the scene, of a box that end effectors may not
                leave; None for no such box.
            deadline: Longest time that a check may take [s], after which it counts as a refusal; None for 10 ms in real
                time and none in simulated time.

        Raises:
            InvalidSetup: An option has no valid value.
        """
        if on_hit not in get_args(OnHit):
            raise InvalidSetup(f"on_hit is {on_hit!r}; valid: {', '.join(map(repr, get_args(OnHit)))}.")
        if not (0 <= near_margin <= margin < math.inf):
            raise InvalidSetup(
                f"margin is {margin} m and near_margin {near_margin} m; valid is 0 <= near_margin <= margin."
            )
        if any(isinstance(pair, str) or len(pair) != 2 for pair in allow):
            raise InvalidSetup(f"allow is {allow!r}; valid are pairs of names of bodies.")
        if deadline is not None and not deadline > 0:
            raise InvalidSetup(f"deadline is {deadline!r} s; valid is a time above 0, or None.")
        self.on_hit: OnHit = on_hit
        self._margin, self._near_margin = margin, near_margin
        self._near, self._touch = None if near is None else tuple(near), None if touch is None else tuple(touch)
        self._allow = [(str(a), str(b)) for a, b in allow]
        self._workspace = workspace
        self._deadline = deadline
        self._commanded: dict[str, NDArray[np.float64]] = {}
        self._fraction: Any = 1.0
        self._floors: dict[tuple[int, int], float] = {}
        self._scene: GuardedScene | None = None

    def bind(self, parts: Parts, world: World | None, compose: Callable[[], Scene]) -> None:
        """Compile the scene for the checks.

        Raises:
            InvalidSetup: Copies are to be refused, or a body has no such name.
        """
        if world is not None and world.leading and self.on_hit != "clip":
            raise InvalidSetup(
                f"on_hit is {self.on_hit!r}, which is of all robots of one environment; copies are cut one by one: use "
                "on_hit='clip'."
            )
        is_real = bool(parts.devices) or parts.setup.stepping == "realtime"
        self.deadline = self._deadline or (DEADLINE if is_real else math.inf)
        objects = parts.task.objects()
        self._scene = scene = GuardedScene(
            compose,
            parts.robots,
            world,
            margin=self._margin,
            near_margin=self._near_margin,
            near=self._near,
            touch=objects if self._touch is None else self._touch,
            ignore=objects if parts.devices else (),  # nobody knows where they are
            allow=self._allow,
            workspace=self._workspace,
        )
        self._names = [robot.name for robot in parts.robots] if len(parts.robots) > 1 else [""]
        # A synchronous step ends at rest; else the target is passed at the speed at which it moves.
        self._period = math.inf if parts.setup.stepping == "sync" else 1.0 / parts.setup.frequency
        self._accelerations = scene.accelerations
        self._is_batch = world is not None and bool(world.leading)
        self._arm_mask = scene.arm_mask

    def reset(self, measured: Mapping[str, Observation], where: Where) -> None:
        """Count from where the robots are."""
        for name in self._names:
            joints = np.array(measured[name][JOINTS], np.float64)
            if name in self._commanded and where is not ...:
                commanded = self._commanded[name].copy()
                commanded[where] = joints[where]
                joints = commanded
            self._commanded = {**self._commanded, name: joints}
        self._floors.clear()

    def rebase(self, measured: Mapping[str, Observation]) -> None:
        """Count from where the robots are."""
        self.reset(measured, ...)

    def sent(self, targets: Mapping[str, Action]) -> None:
        """Remember what was commanded."""
        self._commanded = {name: np.array(targets[name][JOINTS], np.float64) for name in self._names}

    def info(self) -> dict[str, Any]:
        """Return `guard_fraction`: the part of the way that was admitted, (*leading,)."""
        return {FRACTION: np.array(self._fraction)}

    def admit(self, targets: Mapping[str, Action], measured: Mapping[str, Observation]) -> Mapping[str, Action]:
        """Return the targets, cut where the way is not free.

        Raises:
            Refused: The way is not free, and is not to be cut.
        """
        scene = self._require_scene()
        commanded = {name: {JOINTS: self._commanded[name]} for name in self._names}
        here = scene.vector(measured, measured)
        start = scene.vector(commanded, measured)
        goal = scene.vector(targets, targets)
        if self._is_batch:
            parts = [self._part_of(copy, here[copy], start[copy], goal[copy]) for copy in range(len(goal))]
            self._fraction = np.array([part.fraction for part in parts])
        else:
            part = self._part_of(0, here, start, goal)
            self._fraction = part.fraction
            if part.why and (self.on_hit != "clip" or not part.is_free):
                self._fraction = 0.0
                refused = Refused(part.why)
                refused.ends_episode = self.on_hit == "stop"
                raise refused
            parts = [part]
        if all(part.fraction == 1.0 for part in parts):
            return targets
        return self._cut(targets, measured, parts)

    def _part_of(
        self, copy: int, here: NDArray[np.float64], start: NDArray[np.float64], goal: NDArray[np.float64]
    ) -> _Part:
        """Return how much of the way of one copy is free; (dof,) each."""
        self._require_scene().look(copy)
        found = self._sweep(copy, here, start, goal)
        if found is None:
            return _Part(1.0, True, True, "")
        fraction, why = found
        if self.on_hit != "clip":
            return _Part(0.0, False, False, why)
        for _ in range(4):  # what is left must be free from where the arm is, too
            if fraction < SAFE:
                break
            left = self._sweep(copy, here, start, start + fraction * (goal - start))
            if left is None:
                return _Part(fraction, True, False, why)
            fraction *= min(left[0], 0.5)
        still = np.where(self._arm_mask, start, goal)
        if self._sweep(copy, here, start, still) is None:  # fingers move, arms stay
            return _Part(0.0, True, True, why)
        is_free = self._sweep(copy, here, start, start) is None
        return _Part(0.0, is_free, False, why)

    def _sweep(
        self, copy: int, here: NDArray[np.float64], start: NDArray[np.float64], goal: NDArray[np.float64]
    ) -> tuple[float, str] | None:
        """Return the part of the way from start to goal that is free, and what is in the way; None if all of it is."""
        velocity = np.where(self._arm_mask, goal - start, 0.0) / self._period
        stop = velocity * np.abs(velocity) / (2.0 * self._accelerations)
        least: tuple[float, str] | None = None
        ways = [(start, goal, 0.0, 1.0)]
        if np.abs(stop).max() > SAME:
            share = np.abs(stop).max() / np.abs(goal - start).max()
            ways = [(start, goal, 0.0, 1 / (1 + share)), (goal, goal + stop, 1 / (1 + share), 1.0)]
        if np.abs(here - start).max() > SAME:
            ways.append((here, goal, 0.0, 1.0))
        scene = self._require_scene()
        checks = [(scene.far, self._margin), (scene.near, self._near_margin)]  # they are made anew with the geometry
        for number, (checker, margin) in enumerate(checks):
            for begin, end, first, last in ways:
                found = self._first_hit((copy, number), checker, begin, end, margin)
                if found is not None:
                    fraction = max(first + (last - first) * found[0] - SAFE, 0.0)
                    if least is None or fraction < least[0]:
                        least = fraction, found[1]
        return least

    def _first_hit(
        self,
        key: tuple[int, int],
        checker: CollisionChecker,
        begin: NDArray[np.float64],
        end: NDArray[np.float64],
        margin: float,
    ) -> tuple[float, str] | None:
        hit = checker.first_hit(begin, end, STEP, TURN, margin)
        if hit is None:
            return None
        if hit.free_until == 0.0:  # too near already: no nearer than that
            distance = checker.clearance(begin, margin).distance
            if distance < margin:
                floor = self._floors.get(key, -math.inf)
                if distance < floor - 2 * SLACK:  # something else has moved
                    floor = -math.inf
                self._floors[key] = floor = max(floor, distance - SLACK)
                hit = checker.first_hit(begin, end, STEP, TURN, floor)
                if hit is None:
                    return None
        else:
            self._floors.pop(key, None)
        words = self._require_scene().describe(hit.geoms)
        distance = 1e3 * hit.distance
        return hit.free_until, (
            f"After {100 * hit.free_until:.0f} % of the way, {words} would be {distance:.1f} mm apart; the guard keeps "
            f"{1e3 * margin:g} mm."
        )

    def _cut(
        self, targets: Mapping[str, Action], measured: Mapping[str, Observation], parts: Sequence[_Part]
    ) -> Mapping[str, Action]:
        """Return the targets with every copy cut to its part of the way."""
        cut: dict[str, Action] = {name: dict(own) for name, own in targets.items()}

        def of(flags: list[Any]) -> NDArray[Any]:
            return np.array(flags)[:, None] if self._is_batch else np.array(flags[0])

        fraction = of([part.fraction for part in parts])
        is_free = of([part.is_free for part in parts])
        fingers = np.where(of([part.has_fingers for part in parts]), 1.0, fraction)
        for name in self._names:
            start = np.where(is_free, self._commanded[name], measured[name][JOINTS])
            # What is admitted as a whole keeps its bits.
            goal = np.asarray(targets[name][JOINTS])
            cut[name][JOINTS] = np.where(fraction == 1.0, goal, start + fraction * (goal - start))
            for key in (GRIPPER, HAND):
                if key in cut[name]:
                    goal, start = np.asarray(targets[name][key]), np.asarray(measured[name][key])
                    cut[name][key] = np.where(fingers == 1.0, goal, start + fingers * (goal - start)).astype(goal.dtype)
        return cut

    def _require_scene(self) -> GuardedScene:
        if self._scene is None:
            raise InvalidSetup("A guard works in an environment: give it to rcs.make(..., gates=[...]).")
        return self._scene

    def __str__(self) -> str:
        """Return the guard with what it keeps."""
        box = "" if self._workspace is None else f", workspace {self._workspace}"
        return f"Guard: {self.on_hit}, margin {1e3 * self._margin:g} mm, near {1e3 * self._near_margin:g} mm{box}"


class _Part:
    """How much of a way is admitted, and why not all of it."""

    def __init__(self, fraction: float, is_free: bool, has_fingers: bool, why: str) -> None:
        self.fraction = fraction
        """Of the way from what was commanded last."""
        self.is_free = is_free
        """Whether this part is free; if not, not even staying at the last command is, so they stay as measured."""
        self.has_fingers = has_fingers
        """Whether fingers go all of their way."""
        self.why = why
        """What is in the way; empty for nothing."""
