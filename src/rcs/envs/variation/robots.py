"""Variation of robots: starts, drives, grippers, latency; and of the height of the table.

Starts are around home, within the limits of the joints, and free of collisions. MuJoCo's own history of controls delays
actions. A state contains it, and with it the actions that are on their way.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.sim.robot import RobotLayout, SimRobot
from rcs.sim.scene import TABLE, RobotPlacement
from rcs.sim.world import Copies

if TYPE_CHECKING:  # the randomiser calls this module
    from rcs.envs.variation.randomiser import Randomiser, Values


def add_drives(vary: Randomiser, robots: Sequence[RobotPlacement]) -> None:
    """Vary damping of joints, gains of the arms' servos, and the force of end effectors."""
    world, model = vary.world, vary.world.model
    is_robots = np.zeros(model.nbody, np.bool_)
    for robot in robots:
        is_robots |= world.subtree(robot.base_body)
    dofs = np.flatnonzero(is_robots[model.dof_bodyid] & (model.dof_damping > 0))
    vary.scale(
        "joint_damping", [model.joint(model.dof_jntid[i]).name for i in dofs], {"dof_damping": [[i] for i in dofs]}
    )
    layouts = [RobotLayout.of(robot, model) for robot in robots]
    servos = [i for layout in layouts for i in layout.actuator_ids]
    _add_servos(vary, [i for i in servos if model.actuator_biastype[i] != mujoco.mjtBias.mjBIAS_NONE])
    _add_grippers(vary, [robot.name for robot in robots], layouts)


def _add_servos(vary: Randomiser, servos: Sequence[int]) -> None:
    names = [vary.world.model.actuator(i).name for i in servos]
    fields = [field for field in ("servo_stiffness", "servo_damping") if vary.enable(field, names)]
    if not fields:
        return
    # A servo's force is gainprm[0] * target + biasprm[1] * position + biasprm[2] * velocity.
    gains, biases = (vary.rows(f"actuator_{kind}prm", servos) for kind in ("gain", "bias"))

    def write(drawn: dict[str, Values], copies: Copies) -> None:
        one = np.ones_like(drawn[fields[0]])
        stiffness, damping = drawn.get("servo_stiffness", one), drawn.get("servo_damping", one)
        gain = np.broadcast_to(gains.nominal, (*one.shape, gains.nominal.shape[-1])).copy()
        bias = np.broadcast_to(biases.nominal, (*one.shape, biases.nominal.shape[-1])).copy()
        gain[..., 0] *= stiffness
        bias[..., 1] *= stiffness
        bias[..., 2] *= damping
        gains.write(gain, copies)
        biases.write(bias, copies)

    vary.write_with(write)


def _add_grippers(vary: Randomiser, robots: Sequence[str], layouts: Sequence[RobotLayout]) -> None:
    model = vary.world.model
    moved = [i for i, own in enumerate(layouts) if own.finger_joint_ids]
    rows = {
        name: [layouts[i].finger_actuator_ids for i in moved]
        for name in ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
    }
    joints = [layouts[i].finger_joint_ids for i in moved]
    rows["jnt_actfrcrange"] = [[joint for joint in own if model.jnt_actfrclimited[joint]] for own in joints]
    vary.scale("gripper_force", [robots[i] for i in moved], rows)


def add_table(vary: Randomiser) -> None:
    """Vary the height of the table; tasks put their objects on it."""
    world = vary.world
    table = mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_BODY, TABLE)
    if table < 0 or not vary.enable("table_height", [TABLE]):
        return
    vary.changes_constants = True
    rows = vary.rows("body_pos", [table])

    def write(drawn: dict[str, Values], copies: Copies) -> None:
        height = drawn["table_height"]
        rows.write(rows.nominal + np.stack([np.zeros_like(height)] * 2 + [height], axis=-1), copies)

    vary.write_with(write)


def add_latency(vary: Randomiser, robots: Sequence[RobotPlacement]) -> ActionLatency | None:
    """Vary the latency of actions, the same for all robots."""
    if not vary.ranges.varies("action_latency") or not robots:
        return None
    latency = ActionLatency(vary, robots)
    vary.enable("action_latency", ["all robots"], finish=latency.whole_steps)
    vary.write_with(lambda drawn, copies: latency.write(drawn["action_latency"], copies))
    return latency


def keep_history(spec: mujoco.MjSpec, robots: Sequence[RobotPlacement], longest: float) -> None:
    """Make room for late controls of robots in a scene, before it is compiled.

    Args:
        spec: The scene.
        robots: Its robots.
        longest: Longest latency [s].
    """
    samples = int(np.ceil(longest / spec.option.timestep)) + 2
    for robot in robots:
        drives = () if robot.end_effector is None else robot.end_effector.actuators
        names = [robot.prefix + name for name in robot.arm.actuators]
        for name in [*names, *(robot.gripper_prefix + name for name in drives)]:
            spec.actuator(name).nsample = samples


class ActionLatency:
    """The latency of all robots of a world; with one of 0, servos get their targets at once."""

    def __init__(self, vary: Randomiser, robots: Sequence[RobotPlacement]) -> None:
        """Look the robots up in a world whose scene was given to `keep_history`."""
        world, model = vary.world, vary.world.model
        layouts = [RobotLayout.of(robot, model) for robot in robots]
        self._ids = [i for one in layouts for i in (*one.actuator_ids, *one.finger_actuator_ids)]
        self._world = world
        self._step = float(model.opt.timestep)
        self._delays = vary.rows("actuator_delay", self._ids)
        # Where the history of each actuator has its values, which lie among the times of when they were given.
        self._slots = [_slots(model, i) for i in self._ids]

    def whole_steps(self, latency: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the nearest latencies that are whole physics steps [s]."""
        return np.round(latency / self._step) * self._step

    def write(self, latency: NDArray[np.float64], copies: Copies = None) -> None:
        """Set the latency of some copies [s], in whole physics steps, (*leading of these, 1)."""
        # Half a step less, since MuJoCo rounds up, and times that are sums of steps are not exact.
        delay = np.maximum(latency - 0.5 * self._step, 0.0)
        self._delays.write(np.broadcast_to(delay, (*delay.shape[:-1], len(self._ids))), copies)

    def settle(self, copies: Copies = None) -> None:
        """Fill the history of some copies with their present controls."""
        ctrl = self._world.ctrl
        history = self._history()
        for actuator, slots in zip(self._ids, self._slots, strict=True):
            if copies is None:
                history[..., slots] = ctrl[..., actuator, None]
            else:
                history[np.ix_(copies, slots)] = ctrl[copies, actuator, None]

    def _history(self) -> NDArray[np.float64]:
        if self._world.data is not None:
            return self._world.data.history
        return self._world.core.component(mujoco.mjtState.mjSTATE_HISTORY.value)


def _slots(model: mujoco.MjModel, actuator: int) -> NDArray[np.intp]:
    """Return where in the history of a state the values of an actuator are: where other values make a difference."""
    data = mujoco.MjData(model)
    samples = int(model.actuator_history[actuator, 0])
    filled: list[NDArray[np.float64]] = []
    for value in (1.0, 2.0):
        mujoco.mj_initCtrlHistory(model, data, actuator, None, np.full((samples, 1), value))
        filled.append(np.array(data.history))
    return np.flatnonzero(filled[0] != filled[1])


TRIES = 16
"""Deviations that are drawn for each start; the first one without a collision counts, or home."""
CLEARANCES = (0.10, 0.08, 0.06, 0.04, 0.02, 0.0)
"""Height above the table that a start keeps free [m], for objects: the first of these that home keeps free."""


class VariedStart:
    """Draws starts of all robots of a world, and puts robots there."""

    def __init__(self, vary: Randomiser, robots: Sequence[RobotPlacement]) -> None:
        """Enable the fields of a robot's start, if their ranges have a width."""
        self._vary = vary
        arms = [robot.arm for robot in robots]
        joints = [robot.prefix + name for robot in robots for name in robot.arm.joints]
        self._sizes = np.cumsum([0, *(arm.dof for arm in arms)])
        most = vary.ranges.robot_start
        if vary.ranges.varies("robot_start") and joints:
            free = _FreeSpace(vary, robots)
            home = np.concatenate([arm.home for arm in arms])
            low = np.maximum(np.concatenate([arm.joint_lower for arm in arms]) - home, -most)
            high = np.minimum(np.concatenate([arm.joint_upper for arm in arms]) - home, most)
            draws = np.tile(low, (TRIES, 1)), np.tile(high, (TRIES, 1))
            vary.enable("robot_start", joints, bounds=draws, finish=free.first)
        self._jaws = [robot.name for robot in robots if robot.gripper is not None]
        vary.enable("gripper_opening", self._jaws)

    def place(self, robots: Sequence[SimRobot], copies: Copies = None) -> None:
        """Put the robots of some copies where their present episodes start, by writing the state."""
        drawn = {
            field: values if copies is None else values[copies]
            for field, values in self._vary.values.items()
            if field in ("robot_start", "gripper_opening")
        }
        if not drawn:
            return
        for i, robot in enumerate(robots):
            leading = next(iter(drawn.values())).shape[:-1]
            joints = np.broadcast_to(np.array(robot.placement.arm.home), (*leading, robot.placement.arm.dof))
            if "robot_start" in drawn:
                joints = joints + drawn["robot_start"][..., self._sizes[i] : self._sizes[i + 1]]
            opening = None
            if "gripper_opening" in drawn and robot.placement.name in self._jaws:
                jaw = self._jaws.index(robot.placement.name)
                opening = drawn["gripper_opening"][..., jaw : jaw + 1]
            robot.put(joints, opening, copies=copies)


class _FreeSpace:
    """Finds contacts of robots in a scene without objects and with a higher table.

    They depend on the robots' joints alone, whatever else varies.
    """

    def __init__(self, vary: Randomiser, robots: Sequence[RobotPlacement]) -> None:
        world = vary.world
        self._model = copy.copy(world.model)
        self._data = mujoco.MjData(self._model)
        model = self._model
        is_robots = np.zeros(model.nbody, np.bool_)
        for robot in robots:
            is_robots |= world.subtree(robot.base_body)
        ignored = ~is_robots[model.geom_bodyid] & (model.body_weldid[model.geom_bodyid] != 0)
        model.geom_contype[ignored] = model.geom_conaffinity[ignored] = 0
        model.flex_contype[:] = model.flex_conaffinity[:] = 0
        layouts = [RobotLayout.of(robot, model) for robot in robots]
        self._qpos = np.concatenate([model.jnt_qposadr[one.joint_ids] for one in layouts]).astype(np.intp)
        self._home = np.concatenate([robot.arm.home for robot in robots])
        for robot, one in zip(robots, layouts, strict=True):
            if robot.end_effector is not None:
                self._data.qpos[one.finger_qpos] = robot.end_effector.joint_open
        self._usual: frozenset[tuple[int, int]] = frozenset()
        self._usual = self._touching(self._home)
        table = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, TABLE)
        if table >= 0:
            lowest = float(model.body_pos[table, 2])
            for clearance in CLEARANCES:
                model.body_pos[table, 2] = lowest + clearance
                if self._touching(self._home) <= self._usual:
                    break

    def first(self, deviations: Values) -> Values:
        """Return for each start the first of its deviations that touches nothing that home does not touch.

        Args:
            deviations: From home [rad], (..., tries, joints).

        Returns:
            One for each, (..., joints); zeros where all touch something.
        """
        rows = deviations.reshape(-1, *deviations.shape[-2:])
        chosen = np.zeros((len(rows), rows.shape[-1]))
        for row, own in zip(chosen, rows, strict=True):
            for deviation in own:
                if self._touching(self._home + deviation) <= self._usual:
                    row[:] = deviation
                    break
        return chosen.reshape(*deviations.shape[:-2], -1)

    def _touching(self, joints: NDArray[np.float64]) -> frozenset[tuple[int, int]]:
        """Return the pairs of bodies that touch."""
        self._data.qpos[self._qpos] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        if not self._data.ncon:
            return frozenset()
        geoms = self._data.contact.geom[self._data.contact.dist < 0.0]
        bodies = np.sort(self._model.geom_bodyid[geoms], axis=-1)
        return frozenset((int(one), int(other)) for one, other in bodies)
