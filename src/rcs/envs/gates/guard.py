"""A guard: no target reaches a device whose way there comes too near to anything.

The guard checks what will be executed: where the arms are led in this step, each along its own trajectory, and
where they then go while they brake to rest, in steps of at most 2 mm and 0.5 degrees (in C++). So there is always a
way to stop that was found free. Where a robot stands too near already, it may move along and away, but no nearer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rcs._core import CollisionChecker
from rcs.envs.gates.gate import Gate
from rcs.envs.gates.guarded_motion import TICK, GuardedMotions
from rcs.envs.gates.guarded_scene import Box, GuardedScene
from rcs.envs.layers.layer import CopyIndex, renew
from rcs.envs.spaces import GRIPPER, HAND, JOINTS, Action, Observation
from rcs.errors import InvalidSetup, Refused
from rcs.sim.scene import Scene

if TYPE_CHECKING:
    from rcs.envs.parts import Parts
    from rcs.sim.world import World

OnHit = Literal["reject", "clip", "stop"]
"""Consequence when the way is not free: all devices hold; all robots go the last safe part of their way; all devices
hold and the episode ends."""

STEP = 0.002
"""No point of a robot moves by more than this between two checks of what is near [m]."""
TURN = math.radians(0.5)
"""And nothing turns by more than this [rad]."""

DEADLINE = 0.01
"""Longest time that a check may take in real time [s]."""

SLACK = 1e-5
"""By how much the distance to what is too near already may shrink: rounding of distances [m]."""

CUTS = 4
"""How often the part of a way that may be gone is halved: it is known to a sixteenth."""

FRACTION = "guard_fraction"
"""Key of `info`: the part of the way that was admitted, 1 for all of it."""


class Guard(Gate):
    """Checks the way of all robots to their targets before any device sees them."""

    memory = ("_commanded", "_floors", "_scene")

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
            on_hit: Reaction to a way that is not free. Copies of a batch are cut one by one, which is `clip`.
            margin: Distance that robots keep from themselves, each other and everything else [m].
            near_margin: Distance that end effectors keep from the bodies in `near`, and links of a robot from each
                other that are close by construction [m].
            near: Bodies that work brings end effectors close to; None for the table, if there is one.
            touch: Bodies that end effectors may touch; None for the task's objects.
            allow: More bodies that may touch, in pairs of names, such as `[["fr3/gripper/hand", "fixture"]]`.
            workspace: Lowest and highest corner [m] in the frame of the scene, of a box that end effectors may not
                leave, or the flange of an arm without one; None for no such box.
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
        self._must_hold = np.array(False)
        self._floors: NDArray[np.float64] = np.full(2, -np.inf)
        """Least distance that is kept where something is too near already [m], by checker, (*leading, 2)."""
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
        self._scene = GuardedScene(
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
        self._robots = list(parts.robots)
        self._names = [robot.name for robot in parts.robots] if len(parts.robots) > 1 else [""]
        self._motions = GuardedMotions(parts.robots, world, parts.devices.arms, 1.0 / parts.setup.frequency)
        self._is_synchronous = parts.setup.stepping == "sync"
        self._finger_places = math.ceil(1.0 / parts.setup.frequency / TICK)
        leading: tuple[int, ...] = () if world is None else world.leading
        self._is_batch = bool(leading)
        self._floors = np.full((*leading, 2), -np.inf)

    def reset(self, measured: Mapping[str, Observation], where: CopyIndex) -> None:
        """Count from where the robots are."""
        self._count_from(measured, self._names, where)
        self._require_scene().forget(where)

    def rebase(self, measured: Mapping[str, Observation]) -> None:
        """Count from where the measured robots are; what others were commanded, they still follow."""
        self._count_from(measured, [name for name in self._names if name in measured], ...)

    def _count_from(self, measured: Mapping[str, Observation], names: Sequence[str], where: CopyIndex) -> None:
        for name in names:
            joints = np.array(measured[name][JOINTS], np.float64)
            self._commanded = {**self._commanded, name: renew(self._commanded.get(name), joints, where)}
        robots = [robot.name for robot, name in zip(self._robots, self._names, strict=True) if name in names]
        commanded = self._of_copy(self._commanded, 0)
        self._motions.stand({robot: commanded[robot] for robot in robots})
        floors = self._floors.copy()
        floors[where] = -np.inf
        self._floors = floors

    def sent(self, targets: Mapping[str, Action]) -> None:
        """Remember what was commanded."""
        self._commanded = {name: np.array(targets[name][JOINTS], np.float64) for name in self._names}
        self._motions.sent(self._of_copy(self._commanded, 0))
        self._motions.hold(self._must_hold)

    def info(self) -> dict[str, Any]:
        """Return `guard_fraction`: the part of the way that was admitted, (*leading,)."""
        return {FRACTION: np.array(self._fraction)}

    def admit(self, targets: Mapping[str, Action], measured: Mapping[str, Observation]) -> Mapping[str, Action]:
        """Return the targets, cut where the way is not free.

        Raises:
            Refused: The way is not free, and is not to be cut.
        """
        scene = self._require_scene()
        here = scene.vector(measured, measured)
        fingers = scene.vector(measured, targets)
        closing = scene.vector(measured, _without_opening(targets, measured))
        goal = {name: np.asarray(targets[name][JOINTS], np.float64) for name in self._names}
        if self._is_batch:
            rows = enumerate(zip(here, fingers, closing, strict=True))
            parts = [self._part_of(copy, *joints, goal) for copy, joints in rows]
            self._fraction = np.array([part.fraction for part in parts])
            self._must_hold = np.array([part.must_hold for part in parts])
        else:
            part = self._part_of(0, here, fingers, closing, goal)
            self._fraction = part.fraction
            self._must_hold = np.array(part.must_hold)
            if part.must_hold and not (self.on_hit == "clip" and self._motions.can_hold()):
                self._fraction = 0.0
                self._must_hold = np.array(False)
                refused = Refused(part.why)
                refused.ends_episode = self.on_hit == "stop"
                raise refused
            parts = [part]
        if all(part.fraction == 1.0 for part in parts):
            return targets
        return self._cut(targets, measured, parts)

    def _part_of(
        self,
        copy: int,
        here: NDArray[np.float64],
        fingers: NDArray[np.float64],
        closing: NDArray[np.float64],
        goal: Mapping[str, NDArray[np.float64]],
    ) -> _Part:
        """Return how much of the way of one copy is free.

        Args:
            copy: The copy.
            here: All joints as measured, (dof,).
            fingers: The same with the fingers at their targets.
            closing: The same with the fingers at their targets, but none that opens.
            goal: Targets of the arms, (*leading, dof) each.
        """
        self._require_scene().look(copy, here)
        asked, start = self._of_copy(goal, copy), self._of_copy(self._commanded, copy)
        why = self._sweep(copy, here, fingers, self._motions.ways(copy, asked))
        if not why:
            return _Part(1.0, "")
        if self.on_hit == "clip":
            free, hit = 0.0, 1.0
            for _ in range(CUTS):
                middle = 0.5 * (free + hit)
                nearer = {name: start[name] + middle * (asked[name] - start[name]) for name in asked}
                if self._sweep(copy, here, here, self._motions.ways(copy, nearer)):
                    hit = middle
                else:
                    free = middle
            way = self._motions.ways(copy, {name: start[name] + free * (asked[name] - start[name]) for name in asked})
            if free > 0.0 or not self._sweep(copy, here, here, way):
                return _Part(free, why, may_close=not self._sweep(copy, here, closing, way))
        held = self._motions.ways(copy, None)
        rest = dict(zip(asked, (way[-1] for way in held), strict=True))
        if self.on_hit != "clip":
            return _Part(0.0, why, rest, must_hold=True)
        way = self._motions.ways(copy, rest)
        if must_hold := bool(self._sweep(copy, here, here, way)):
            way = [own[:1] for own in held]  # fingers close at least where they are
        return _Part(0.0, why, rest, must_hold, may_close=not self._sweep(copy, here, closing, way))

    def _of_copy(self, joints: Mapping[str, NDArray[np.float64]], copy: int) -> dict[str, NDArray[np.float64]]:
        """Return the joints of one copy, by the names of the robots."""
        names = [robot.name for robot in self._robots]
        rows = [joints[name][copy] if self._is_batch else joints[name] for name in self._names]
        return dict(zip(names, rows, strict=True))

    def _sweep(
        self, copy: int, here: NDArray[np.float64], fingers: NDArray[np.float64], ways: Sequence[NDArray[np.float64]]
    ) -> str:
        """Return what is in the way of all robots from where they are measured; empty for nothing."""
        scene = self._require_scene()
        count = len(ways[0])
        share = np.minimum(np.arange(count) / (count if self._is_synchronous else self._finger_places), 1.0)
        places = scene.places(ways, here + share[:, None] * (fingers - here))
        end = np.where(scene.finger_mask, fingers, places[-1])
        places = np.concatenate([here[None], places[1:], end[None]])
        checks = [(scene.far, self._margin), (scene.near, self._near_margin)]  # they are made anew with the geometry
        for number, (checker, margin) in enumerate(checks):
            if why := self._first_hit((copy, number) if self._is_batch else (number,), checker, places, margin):
                return why
        return ""

    def _first_hit(
        self, key: tuple[int, ...], checker: CollisionChecker, places: NDArray[np.float64], margin: float
    ) -> str:
        hit = checker.first_hit_on_way(places, STEP, TURN, margin)
        if hit is None:
            return ""
        if hit.free_until == 0.0:  # too near already: no nearer than that
            distance = checker.clearance(places[0], margin).distance
            if distance < margin:
                floor = float(self._floors[key])
                if distance < floor - 2 * SLACK:  # something else has moved
                    floor = -math.inf
                self._floors[key] = floor = max(floor, distance - SLACK)
                hit = checker.first_hit_on_way(places, STEP, TURN, floor)
                if hit is None:
                    return ""
        else:
            self._floors[key] = -math.inf
        words = self._require_scene().describe(hit.geoms)
        distance = 1e3 * hit.distance
        return (
            f"After {100 * hit.free_until:.0f} % of the way, {words} would be {distance:.1f} mm apart; the guard keeps "
            f"{1e3 * margin:g} mm."
        )

    def _cut(
        self, targets: Mapping[str, Action], measured: Mapping[str, Observation], parts: Sequence[_Part]
    ) -> Mapping[str, Action]:
        """Return the targets with every copy cut to its part of the way; fingers may close where a way is cut."""
        cut: dict[str, Action] = {name: dict(own) for name, own in targets.items()}

        def of(values: list[Any]) -> NDArray[Any]:
            return np.array(values) if self._is_batch else np.array(values[0])

        fraction = of([[part.fraction] for part in parts])
        is_held = of([[part.rest is not None] for part in parts])
        may_close = of([[part.may_close] for part in parts])
        closing = _without_opening(targets, measured)
        for name, robot in zip(self._names, self._robots, strict=True):
            start, goal = self._commanded[name], np.asarray(targets[name][JOINTS])
            rest = [np.zeros(robot.arm.dof) if part.rest is None else part.rest[robot.name] for part in parts]
            # A motion that is admitted as a whole keeps its bits.
            mine = np.where(fraction == 1.0, goal, start + fraction * (goal - start))
            cut[name][JOINTS] = np.where(is_held, of(rest), mine)
            for key in (GRIPPER, HAND):
                if key in cut[name]:
                    goal = np.asarray(targets[name][key])
                    kept = np.where(may_close, closing[name][key], measured[name][key])
                    cut[name][key] = np.where(fraction == 1.0, goal, kept).astype(goal.dtype)
        return cut

    def _require_scene(self) -> GuardedScene:
        if self._scene is None:
            raise InvalidSetup("A guard works in an environment: give it to rcs.make(..., gates=[...]).")
        return self._scene

    def __str__(self) -> str:
        """Return the guard with what it keeps."""
        box = "" if self._workspace is None else f", workspace {self._workspace}"
        return f"Guard: {self.on_hit}, margin {1e3 * self._margin:g} mm, near {1e3 * self._near_margin:g} mm{box}"


@dataclass(frozen=True)
class _Part:
    """How much of a way is admitted, and why not all of it."""

    fraction: float
    """Share of the way from the last command."""
    why: str
    """The obstacle in the way; empty for none."""
    rest: Mapping[str, NDArray[np.float64]] | None = None
    """Joints at which the arms come to rest when they brake now, where even the last command may not continue."""
    must_hold: bool = False
    """Whether the arms must brake now, as nothing else is free."""
    may_close: bool = False
    """Whether fingers may go on closing, which keeps what they hold; if not, they stay where they are measured."""


def _without_opening(
    targets: Mapping[str, Action], measured: Mapping[str, Observation]
) -> dict[str, dict[str, NDArray[Any]]]:
    """Return targets of fingers, none of which opens: grippers open no farther than measured, and hands stay."""
    return {
        name: {
            key: np.minimum(own[key], measured[name][key]) if key == GRIPPER else np.asarray(measured[name][key])
            for key in (GRIPPER, HAND)
            if key in own
        }
        for name, own in targets.items()
    }
