"""Teachers of PickCuboid and Place, which act from wherever the arm is, so that they can label every state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rcs.agents.agent import Agent
from rcs.agents.grasp import CLEARANCE, EMPTY, closing_yaw
from rcs.envs.env import Env
from rcs.envs.spaces import GRIPPER, IS_GRASPED, JOINTS, PRIVILEGED, TARGET, TQUAT, Action, Observation
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup
from rcs.kinematics import freedom_of, kinematics_of
from rcs.spatial import distance, interpolate, tquat_to_matrix
from rcs.tasks.pick_cuboid import CUBOID, PickCuboid
from rcs.tasks.place import MARK, Place

SPEED, TURN_SPEED = 0.35, 2.0
"""Highest speeds of the TCP [m/s, rad/s]."""
GAIN = 10.0
"""Most speed in proportion to the distance from the goal [1/s]. A learner's errors would drown what is much slower."""
ALIGNED = (0.010, 0.15)
"""Deviation from the grasp in the plane [m] and about the vertical [rad] up to which the hand goes down to it."""
STEEPNESS = (4.5, 0.2)
"""Height to keep above the grasp per deviation beyond that, in the plane [m/m] and about the vertical [m/rad]."""
SLOWED = 0.03
"""Height below the one to keep at which the hand moves only up [m], so that its fingers push nothing away."""
REACHED = (0.014, 0.016, 0.30)
"""Deviations from the grasp at which the gripper closes: in height and in the plane [m], about the vertical [rad]."""
KEPT = 1.5
"""Factor on these at which a gripper that is closing goes on to close."""
CLOSING = 0.95
"""Opening below which a gripper is closing."""
ABOVE_GOAL = 0.03
"""Height above that of the task to which the cuboid is lifted [m]."""
TURN_RANGE = np.deg2rad(115.0)
"""Largest turn of the tool from where it is at home [rad]: of the two ways to grasp, the nearer one within it."""

Goal = tuple[NDArray[np.float64], NDArray[np.bool_]]
"""Goal of the TCP, (*leading, 7), and whether to open the gripper, (*leading,)."""


class PickTeacher(Agent):
    """Picks the cuboid with one step of feedback per action, from any state, in one environment or in many copies.

    It remembers nothing: an action follows from the TCP pose, the last target, the opening, the pose of the cuboid and
    whether it is grasped. So it can label states that other actions led to, as DAgger needs, and a policy
    that sees as much can learn it. It moves above the cuboid, into a funnel that leads down to the grasp, closes, and
    lifts; without the cuboid between its pads it opens and starts anew. `PickExpert` goes through phases instead, waits
    in them, plans its grasp and keeps away from joint limits.
    """

    task: ClassVar[type[PickCuboid | Place]] = PickCuboid
    """The task."""

    def __init__(self, env: Env | VecEnv) -> None:
        """Prepare for an environment.

        Raises:
            InvalidSetup: The task is another one, actions are not joints relative to the last step, the robot has no
                gripper, or the environment does not observe `privileged`, `contacts` and the last target.
        """
        setup = env.setup
        task = None if env.simulation is None else env.simulation.task
        name = type(self).__name__
        if not isinstance(task, self.task) or len(env.robots) != 1:
            raise InvalidSetup(f"{name} is for {self.task.__name__} with one arm; the setup has {setup.task!r}.")
        if (setup.control, setup.relative) != (JOINTS, "last_step"):
            raise InvalidSetup(
                f"{name} gives joints relative to the last step; the setup has control={setup.control!r} and "
                f"relative={setup.relative!r}."
            )
        space: Any = getattr(env, "single_observation_space", env.observation_space)
        if TARGET not in space.spaces:
            raise InvalidSetup(f"{name} counts from the last target; give layers=('ObserveTarget',).")
        if missing := sorted({"privileged", "contacts"} - set(setup.observe)):
            raise InvalidSetup(f"{name} sees {missing} too; give observe=('privileged', 'contacts').")
        (robot,) = env.robots.values()
        if robot.gripper is None:
            raise InvalidSetup(f"{name} needs a gripper; {robot.name!r} has none.")
        self._period = 1.0 / setup.frequency
        self._kinematics = kinematics_of(robot.arm, robot.gripper)
        home = np.array(robot.arm.home)
        self._options = freedom_of(self._kinematics, best_effort=True, preferred=home)
        self._home_yaw = float(_yaw(self._kinematics.forward(home).tquat))
        self._bound = np.array(robot.arm.velocity_limit) * self._period
        self._edges: tuple[float, ...] = task.edges
        if isinstance(task, PickCuboid):
            base_height = float(robot.base_in_scene.translation[2])
            self._lifted = task.options.lift_height + 0.5 * self._edges[2] + ABOVE_GOAL - base_height

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Do nothing: there is nothing to remember."""

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the action for a state, or an array of them for the states of all copies."""
        # Actions count from the last target, which the arm is behind: counting from the arm, it would swing.
        joints = observation[TARGET][JOINTS]
        start = self._kinematics.forward_batch(_rows(joints)).reshape(*joints.shape[:-1], 7)
        goal, opens = self._goal(observation, start)
        target = self._towards(goal, start)
        solved, *_ = self._kinematics.inverse_batch(_rows(target), _rows(joints), self._options)
        step = solved.reshape(joints.shape) - joints
        step = step / np.maximum(1.0, np.max(np.abs(step) / self._bound, axis=-1, keepdims=True))
        return {JOINTS: step, GRIPPER: opens.astype(np.float32)[..., None]}

    def _goal(self, observation: Observation, start: NDArray[np.float64]) -> Goal:
        """Return where the TCP shall go from its last target, (*leading, 7), and whether the gripper shall be open."""
        cuboid, tcp = observation[PRIVILEGED][CUBOID][TQUAT], observation[TQUAT]
        opening, is_grasped = observation[GRIPPER][..., 0], observation[IS_GRASPED][..., 0] > 0
        offset = cuboid[..., :3] - tcp[..., :3]
        aside, above = np.hypot(offset[..., 0], offset[..., 1]), -offset[..., 2]
        yaw = _nearest(closing_yaw(cuboid, self._edges), _yaw(tcp), self._home_yaw)
        turned = np.abs(_wrapped(yaw - _yaw(tcp)))
        closes = np.where(opening < CLOSING, KEPT, 1.0)
        is_there = (
            (np.abs(above) < closes * REACHED[0]) & (aside < closes * REACHED[1]) & (turned < closes * REACHED[2])
        )
        is_there &= opening > EMPTY
        has_opened = opening >= CLOSING
        keeps = STEEPNESS[0] * np.maximum(aside - ALIGNED[0], 0.0) + STEEPNESS[1] * np.maximum(turned - ALIGNED[1], 0.0)
        keeps = np.where(has_opened | is_there, np.minimum(keeps, CLEARANCE), CLEARANCE)
        keeps = np.where(is_there & ~has_opened, 0.0, keeps)
        free = np.clip(1.0 - (keeps - above) / SLOWED, 0.0, 1.0)
        goal = np.zeros(tcp.shape)
        goal[..., :2] = start[..., :2] + free[..., None] * (cuboid[..., :2] - start[..., :2])
        goal[..., 2] = cuboid[..., 2] + keeps
        # A half turn about x points the tool down: Rz(yaw) Rx(pi).
        goal[..., 3], goal[..., 4] = np.cos(yaw / 2), np.sin(yaw / 2)
        return self._go_on(observation, start, (goal, ~is_there), is_there & is_grasped)

    def _go_on(
        self, observation: Observation, start: NDArray[np.float64], grasp: Goal, is_held: NDArray[np.bool_]
    ) -> Goal:
        """Return the goal of grasping, changed where the cuboid is held: here, to lift it."""
        goal, opens = grasp
        goal[..., :2] = np.where(is_held[..., None], start[..., :2], goal[..., :2])
        goal[..., 2] = np.where(is_held, self._lifted, goal[..., 2])
        return goal, opens

    def _towards(self, goal: NDArray[np.float64], start: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the next target of the TCP, (*leading, 7)."""
        way, turn = np.moveaxis(distance(start, goal), -1, 0)
        gain = min(GAIN * self._period, 1.0)
        fraction = np.minimum(gain, SPEED * self._period / np.maximum(way, 1e-9))
        turn_fraction = np.minimum(gain, TURN_SPEED * self._period / np.maximum(turn, 1e-9))
        target = interpolate(start, goal, turn_fraction)
        target[..., :3] = start[..., :3] + fraction[..., None] * (goal[..., :3] - start[..., :3])
        return target


def _rows(array: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.ascontiguousarray(array.reshape(-1, array.shape[-1]))


def _yaw(tcp: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angle of the tool's x axis about the vertical [rad], (*leading,)."""
    matrix = tquat_to_matrix(tcp)
    return np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0])


def _wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _nearest(yaw: NDArray[np.float64], now: NDArray[np.float64], home: float) -> NDArray[np.float64]:
    """Return, of a yaw and the opposite one, the nearer to that of the tool within its range."""
    turn = _wrapped(yaw - now)
    other = turn - np.copysign(np.pi, turn)
    first, second = np.abs(turn), np.abs(other)
    first = first + 10.0 * (np.abs(_wrapped(now + turn - home)) > TURN_RANGE)
    second = second + 10.0 * (np.abs(_wrapped(now + other - home)) > TURN_RANGE)
    return now + np.where(first <= second, turn, other)


CARRIED = 0.06
"""Height above the table at which the cuboid is carried [m]."""
OVER_MARK = 0.005
"""Distance beside the mark's middle up to which the cuboid is lowered [m]."""
FUNNEL = 2.5
"""Height to keep per distance beyond that [m/m]."""
PRESSED = 0.002
"""Depth below the table to which it is lowered [m], so that it comes to lie on it."""
SET_DOWN = (0.012, 0.004)
"""Distance beside the mark's middle and height above the table at which it is let go, or left where it is [m]."""
RETREAT = 0.05
"""Height by which the open hand goes up from there [m]."""


class PlaceTeacher(PickTeacher):
    """Puts the cuboid on its mark with one step of feedback per action, from any state, and remembers nothing.

    It grasps as `PickTeacher` does, lifts, carries the cuboid into a funnel that leads down to the mark, and lets go of
    it where it stands. A cuboid that lies on the mark is left alone, even one that fell there and does not count: only
    a memory would show that. `PlaceExpert` goes through phases instead.
    """

    task = Place

    def _go_on(
        self, observation: Observation, start: NDArray[np.float64], grasp: Goal, is_held: NDArray[np.bool_]
    ) -> Goal:
        """Return the goal of grasping, changed where the cuboid is held, and where it lies on its mark."""
        goal, opens = grasp
        cuboid, mark = (observation[PRIVILEGED][name][TQUAT] for name in (CUBOID, MARK))
        way = mark[..., :3] - cuboid[..., :3]
        aside, above = np.hypot(way[..., 0], way[..., 1]), -0.5 * self._edges[2] - way[..., 2]
        keeps = np.minimum(FUNNEL * np.maximum(aside - OVER_MARK, 0.0), CARRIED)
        free = np.clip(1.0 - (keeps - above) / SLOWED, 0.0, 1.0)
        carried = observation[TQUAT].copy()
        carried[..., :2] += free[..., None] * way[..., :2]
        carried[..., 2] += keeps - PRESSED - above
        goal[..., :3] = np.where(is_held[..., None], carried[..., :3], goal[..., :3])
        is_set_down = (aside < SET_DOWN[0]) & (above < SET_DOWN[1])
        left = start[..., :3].copy()
        left[..., 2] += np.where(observation[IS_GRASPED][..., 0] > 0, 0.0, RETREAT)
        goal[..., :3] = np.where(is_set_down[..., None], left, goal[..., :3])
        return goal, opens | is_set_down
