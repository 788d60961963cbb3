"""The scene of an environment as a guard looks at it: what may come how near to what, and which joints move it.

The joints of all robots are one flat vector: of each robot those of the arm, then those of its fingers. Distances come
from two collision checkers. `far` keeps the margin, but leaves out the pairs that work brings together: end effectors
and the table, and links of one robot that are close to each other by construction. `near` has these alone, for a small
margin. Both leave out what may touch: end effectors and the task's objects, and the fingers of one gripper.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs._core import CollisionChecker
from rcs.envs.layers.layer import CopyIndex
from rcs.envs.spaces import GRIPPER, HAND, JOINTS
from rcs.errors import InvalidSetup
from rcs.sim.scene import TABLE, RobotPlacement, Scene
from rcs.sim.world import World
from rcs.spatial import Pose, wxyz_to_xyzw

Box = tuple[Sequence[float], Sequence[float]]
"""Lowest and highest corner [m], in the frame of the scene."""

WALL = "workspace"
"""Name of the body of the walls around a workspace."""
WALL_THICKNESS = 0.2
"""How thick they are [m]: nothing is on the other side after one step."""

SLIP, SLIP_TURN = 1e-3, 0.02
"""A held object that has moved by less in the hand is where it was [m, rad]."""

Held = dict[int, tuple[int, Pose]]
"""Held objects: by body id, the body that holds the object and its pose in that."""

GEOMETRY = ("geom_size", "geom_pos", "geom_quat", "geom_rbound", "geom_aabb", "body_pos", "body_quat")
"""Fields of a model that say where shapes are and how large."""


def lagging(way: NDArray[np.float64], here: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where an arm goes that is led a way (n, dof) and is measured here (dof,) where it begins [rad].

    By how much its servos lag behind falls with the speed at which they are led: at rest, they are where they are led.
    """
    speed = np.linalg.norm(np.diff(way, axis=0, append=way[-1:]), axis=1)
    share = np.minimum(speed / max(speed[0], 1e-9), 1.0)
    return way + share[:, None] * (here - way[0])


class GuardedScene:
    """Two checkers of one scene, and the way from the values of robots to their joints."""

    memory = ("held",)

    def __init__(
        self,
        compose: Callable[[], Scene],
        robots: Sequence[RobotPlacement],
        world: World | None,
        *,
        margin: float,
        near_margin: float,
        near: Collection[str] | None = None,
        touch: Collection[str] = (),
        ignore: Collection[str] = (),
        allow: Iterable[tuple[str, str]] = (),
        workspace: Box | None = None,
    ) -> None:
        """Compile the scene and sort its pairs.

        Args:
            compose: Puts the scene together.
            robots: Its robots.
            world: World with its objects; None for their places in the files.
            margin: Distance that is kept [m].
            near_margin: Distance that is kept where work brings things together [m].
            near: Bodies that end effectors may approach up to `near_margin`; None for the table, if there is one.
            touch: Bodies that end effectors may touch.
            ignore: Bodies that all of the robots may touch, because their places are unknown.
            allow: More bodies that may touch, in pairs.
            workspace: Box that end effectors, or flanges without one, may not leave; None for none.

        Raises:
            InvalidSetup: A body does not exist, the box is empty, or copies of the world differ in their geometry.
        """
        self._robots = list(robots)
        self._world = world
        kinds = (mujoco.mjtState.mjSTATE_MOCAP_POS, mujoco.mjtState.mjSTATE_MOCAP_QUAT)
        self._mocap = [world.core.component(kind.value) for kind in kinds] if world and world.model.nmocap else []
        if world is not None and world.leading and (varied := sorted(set(GEOMETRY) & set(world.varied))):
            raise InvalidSetup(
                f"A guard knows one geometry, and copies differ in {', '.join(varied)}; leave sizes of objects out of "
                "the randomisation."
            )
        scene = compose()
        if workspace is not None:
            _add_walls(scene.spec, workspace)
        self._model = scene.spec.compile()
        self._joints = [self._joints_of(robot) for robot in self._robots]
        names = {self._model.body(i).name for i in range(self._model.nbody)}
        near = names & {TABLE} if near is None else near
        asked = [*near, *touch, *ignore, *itertools.chain.from_iterable(allow)]
        if unknown := sorted(set(asked) - names):
            raise InvalidSetup(f"The scene has no body {unknown[0]!r}; there are {', '.join(sorted(names))}.")
        hands = [{name for name in names if name.startswith(robot.gripper_prefix)} for robot in self._robots]
        arms = [{name for name in names if name.startswith(robot.prefix)} for robot in self._robots]
        self._allowed = [pair for hand in hands for pair in itertools.combinations_with_replacement(hand, 2)]
        self._allowed += [(body, part) for body in touch for hand in hands for part in hand]
        self._allowed += [(body, part) for body in ignore for arm in arms for part in arm]
        # A held object comes down on the table and on other objects.
        self._allowed += [(body, other) for body in touch for other in (*near, *touch) if other != body]
        self._allowed += list(allow)
        if workspace is not None:
            inside = [hand or {self._last_link(robot)} for hand, robot in zip(hands, self._robots, strict=True)]
            self._allowed += [(WALL, part) for arm, own in zip(arms, inside, strict=True) for part in arm - own]
        self._near = [(body, part) for body in near for hand in hands for part in hand]
        self._near += self._close_by_construction(margin)
        held = () if ignore else touch
        self._held_objects = HeldObjects(self._model, held, self._robots)
        self._leading: tuple[int, ...] = () if world is None else world.leading
        self._held: dict[int, Held] = {}
        """Objects that are held, by copy; where one is in the hand changes only when it slips."""
        self._geometry: dict[str, NDArray[Any]] = {}
        self._build()

    def _build(self) -> None:
        """Make the checkers for the present geometry."""
        self._own = self._model.jnt_qposadr[[joint for own in self._joints for joint in own]]
        self._seen: list[NDArray[np.float64]] = []
        self._attached: Held = {}
        """Objects that are held in the copy that was seen last."""
        if self._world is not None:
            for name in GEOMETRY:
                values: NDArray[Any] = getattr(self._world.model, name)
                getattr(self._model, name)[: len(values)] = values
                self._geometry[name] = values.copy()
        self.far = self._checker([*self._allowed, *self._near])
        """Pairs that keep the margin."""
        bodies = self._model.geom_bodyid[self.far.pairs]
        kept = [(self._model.body(a).name, self._model.body(b).name) for a, b in np.unique(bodies, axis=0)]
        self.near = self._checker([*self._allowed, *kept])
        """Pairs that work brings together."""

    def _checker(self, allowed: Iterable[tuple[str, str]]) -> CollisionChecker:
        checker = CollisionChecker(self._model, self._joints)
        for a, b in allowed:
            checker.allow(a, b)
        return checker

    @property
    def held(self) -> NDArray[np.float64]:
        """Held objects: id of the body that holds each, -1 for none, and its pose in that, (*leading, objects, 8)."""
        bodies = self._held_objects.bodies
        held = np.full((*(self._leading or (1,)), len(bodies), 8), -1.0)
        for copy, own in self._held.items():
            for body, (holder, pose) in own.items():
                held[copy, bodies.index(body)] = holder, *pose.tquat
        return held.reshape(*self._leading, len(bodies), 8)

    @held.setter
    def held(self, held: NDArray[np.float64]) -> None:
        bodies = self._held_objects.bodies
        self._held = {}
        for copy, rows in enumerate(held.reshape(*(self._leading or (1,)), len(bodies), 8)):
            own = zip(bodies, rows, strict=True)
            self._held[copy] = {body: (int(row[0]), Pose.from_tquat(row[1:])) for body, row in own if row[0] >= 0}

    def forget(self, where: CopyIndex) -> None:
        """Forget what was held in some copies."""
        self._held = {copy: own for copy, own in self._held.items() if where is not ... and copy not in where}

    def look(self, copy: int, joints: NDArray[np.float64]) -> None:
        """See where everything besides the robots is, in one copy, and what they hold.

        Args:
            copy: The copy.
            joints: All joints of the robots [rad, m], (dof,).
        """
        world = self._world
        if world is None:
            return
        if not world.leading and any(
            not np.array_equal(getattr(world.model, name), self._geometry[name])
            for name in GEOMETRY
            if name in world.varied
        ):
            self._build()
        state = [np.array(part[copy] if world.leading else part) for part in (world.qpos, *self._mocap)]
        state[0][self._own] = joints
        held = self._held_objects.find(state[0])
        state[0][self._own] = self._model.qpos0[self._own]  # where robots are is said with every question
        if not self._seen or not all(map(np.array_equal, self._seen, state)):
            self._seen = state
            for checker in (self.near, self.far):
                checker.set_state(*state)
        self._hold(copy, held)

    def _hold(self, copy: int, held: Held) -> None:
        """Have the objects that are held in a copy move with what holds them."""
        before = self._held.get(copy, {})
        now = {body: before[body] if _is_same(before.get(body), held[body]) else held[body] for body in held}
        for body in self._attached.keys() - now.keys():
            for checker in (self.near, self.far):
                checker.detach(body)
        for body, place in now.items():
            if self._attached.get(body) is not place:
                for checker in (self.near, self.far):
                    checker.attach(body, *place)
        self._held[copy] = self._attached = now

    def vector(
        self, values: Mapping[str, Mapping[str, Any]], fingers: Mapping[str, Mapping[str, Any]]
    ) -> NDArray[np.float64]:
        """Return all joints [rad, m], (*leading, dof).

        Args:
            values: Has the joints of every arm, by robot; a single robot may be "".
            fingers: Has the opening of grippers (0 … 1) or the joints of hands (0 … 1), by robot.
        """
        parts: list[NDArray[np.float64]] = []
        for robot in self._robots:
            own, hand = values.get(robot.name, values.get("", {})), fingers.get(robot.name, fingers.get("", {}))
            parts.append(np.asarray(own[JOINTS], np.float64))
            if robot.gripper is not None:
                parts.append(robot.gripper.joints_of(np.asarray(hand[GRIPPER], np.float64)[..., :1]))
            elif robot.hand is not None:
                parts.append(robot.hand.joints_of(np.asarray(hand[HAND], np.float64)))
        return np.concatenate(parts, axis=-1)

    def places(self, ways: Sequence[NDArray[np.float64]], fingers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return all joints along a way [rad, m], (n, dof).

        Args:
            ways: Joints of every arm along it, (n, dof) each.
            fingers: All joints along it, of which those of fingers are taken, and those of arms where it begins,
                (n, dof).
        """
        places = fingers.copy()
        first = 0
        for way, ids in zip(ways, self._joints, strict=True):
            arm = slice(first, first + way.shape[1])
            places[:, arm] = lagging(way, fingers[0, arm])
            first += len(ids)
        return places

    @property
    def finger_mask(self) -> NDArray[np.bool_]:
        """Which of the joints are those of fingers, (dof,)."""
        return np.concatenate(
            [np.arange(len(ids)) >= robot.arm.dof for robot, ids in zip(self._robots, self._joints, strict=True)]
        )

    def describe(self, geoms: Sequence[int]) -> str:
        """Return a pair of geoms in words."""
        a, b = (self.near.describe(int(geom)) for geom in geoms)
        return f"{a} and {b}"

    def _joints_of(self, robot: RobotPlacement) -> list[int]:
        effector = robot.end_effector
        fingers = () if effector is None else effector.joints
        names = [robot.prefix + name for name in robot.arm.joints] + [robot.gripper_prefix + name for name in fingers]
        return [self._model.joint(name).id for name in names]

    def _last_link(self, robot: RobotPlacement) -> str:
        """Return the body of the TCP, or the nearest one before it that can touch anything."""
        model = self._model
        solid = model.geom_bodyid[(model.geom_contype | model.geom_conaffinity) != 0]
        body = int(model.site(robot.tcp_site).bodyid[0])
        while body and body not in solid:
            body = int(model.body_parentid[body])
        return model.body(body).name

    def _close_by_construction(self, margin: float) -> list[tuple[str, str]]:
        """Return the bodies of one robot that are nearer to each other than the margin at home."""
        model, data = self._model, mujoco.MjData(self._model)
        for robot, ids in zip(self._robots, self._joints, strict=True):
            data.qpos[model.jnt_qposadr[ids[: robot.arm.dof]]] = robot.arm.home
        mujoco.mj_kinematics(model, data)
        found: set[tuple[str, str]] = set()
        for a, b in self._checker(self._allowed).pairs:
            names = [model.body(model.geom_bodyid[geom]).name for geom in (a, b)]
            robots = [next((own.name for own in self._robots if name.startswith(own.prefix)), None) for name in names]
            if robots[0] is None or robots[0] != robots[1]:
                continue
            if mujoco.mj_geomDistance(model, data, int(a), int(b), margin, None) < margin:
                found.add((names[0], names[1]))
        return sorted(found)


def _add_walls(spec: mujoco.MjSpec, workspace: Box) -> None:
    """Add walls around a box."""
    lower, upper = (np.asarray(corner, np.float64) for corner in workspace)
    if lower.shape != (3,) or upper.shape != (3,) or not (np.isfinite([lower, upper]).all() and (lower < upper).all()):
        raise InvalidSetup(f"workspace is {workspace!r}; valid are a lowest and a highest corner, (3,) each [m].")
    body = spec.worldbody.add_body(name=WALL)
    middle, half, thick = (lower + upper) / 2, (upper - lower) / 2, WALL_THICKNESS / 2
    for axis, side in itertools.product(range(3), (-1.0, 1.0)):
        pos, size = middle.copy(), half + 2 * thick
        pos[axis] += side * (half[axis] + thick)
        size[axis] = thick
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=pos, size=size, contype=1, conaffinity=1, rgba=[0, 0, 0, 0])


TOUCH = 1e-3
"""Distance up to which a body touches an object [m]: soft fingers and contacts give way by less."""


class HeldObjects:
    """Looks for held objects in a model."""

    def __init__(self, model: mujoco.MjModel, objects: Iterable[str], robots: Iterable[RobotPlacement]) -> None:
        """Look the bodies up.

        Args:
            model: The scene; its geometry may change later.
            objects: Bodies that may be held; those without a free joint never are.
            robots: Robots that may hold them.
        """
        self._model, self._data = model, mujoco.MjData(model)
        bodies = [model.body(name) for name in objects]
        free = mujoco.mjtJoint.mjJNT_FREE
        self.bodies = [b.id for b in bodies if b.jntnum[0] == 1 and model.jnt_type[b.jntadr[0]] == free]
        """Ids of the objects that may be held."""
        owners = [model.body(body).name for body in model.geom_bodyid]
        solid = (model.geom_contype | model.geom_conaffinity) != 0
        self._hands = [
            np.array([g for g, name in enumerate(owners) if name.startswith(robot.gripper_prefix) and solid[g]])
            for robot in robots
            if robot.end_effector is not None
        ]
        self._geoms = {body: np.flatnonzero(model.geom_bodyid == body) for body in self.bodies}

    def find(self, qpos: NDArray[np.float64]) -> Held:
        """Return what is held in a state (nq,)."""
        held: Held = {}
        if not self.bodies:
            return held
        model, data = self._model, self._data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        for body in self.bodies:
            for hand in self._hands:
                fingers = {int(model.geom_bodyid[b]) for a in self._geoms[body] for b in self._near(int(a), hand)}
                if len(fingers) > 1:
                    root = min(int(model.geom_bodyid[geom]) for geom in hand)  # parents come first
                    held[body] = root, self._pose(root).inverse() * self._pose(body)
                    break
        return held

    def _near(self, geom: int, others: NDArray[np.intp]) -> list[int]:
        """Return which geoms touch one."""
        model, data = self._model, self._data
        reach = model.geom_rbound[geom] + model.geom_rbound[others] + TOUCH
        close = others[np.linalg.norm(data.geom_xpos[others] - data.geom_xpos[geom], axis=1) < reach]
        return [
            int(other) for other in close if mujoco.mj_geomDistance(model, data, geom, int(other), TOUCH, None) < TOUCH
        ]

    def _pose(self, body: int) -> Pose:
        return Pose(self._data.xpos[body], wxyz_to_xyzw(self._data.xquat[body]))


def _is_same(before: tuple[int, Pose] | None, now: tuple[int, Pose]) -> bool:
    """Return whether an object is held by the same body as before and has not slipped."""
    if before is None or before[0] != now[0]:
        return False
    return before[1].distance_to(now[1]) <= SLIP and before[1].angle_to(now[1]) <= SLIP_TURN
