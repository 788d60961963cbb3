"""The robots and what they touch, varied from episode to episode: friction, servos, grippers, latency, the table."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from rcs.envs.variation import Values, Variation
from rcs.sim.action_latency import ActionLatency
from rcs.sim.layout import RobotLayout
from rcs.sim.model_rows import ModelRows
from rcs.sim.scene import TABLE, RobotPlacement
from rcs.sim.world import Copies


def add_friction(vary: Variation, robots: Sequence[RobotPlacement]) -> None:
    """Vary friction: all of it by one factor, and that of each end effector by another one on top."""
    world, model = vary.world, vary.world.model
    carried = [robot for robot in robots if robot.end_effector is not None]
    owner = np.full(model.nbody, -1)
    for i, robot in enumerate(carried):
        assert robot.end_effector is not None
        owner[world.subtree(robot.gripper_prefix + robot.end_effector.base_body)] = i
    has_all = vary.enable("friction", (1,))
    has_pads = vary.enable("pad_friction", (len(carried),), [robot.name for robot in carried])
    if not (has_all or has_pads):
        return
    of_geom = owner[model.geom_bodyid]
    of_pair = np.maximum(of_geom[model.pair_geom1], of_geom[model.pair_geom2]) if model.npair else np.zeros(0, np.intp)
    owners = {"geom_friction": of_geom, "flex_friction": np.full(model.nflex, -1), "pair_friction": of_pair}
    rows = [(ModelRows(world, field, np.arange(len(own))), own) for field, own in owners.items() if len(own)]

    def write(drawn: dict[str, Values], copies: Copies) -> None:
        leading = drawn["friction" if has_all else "pad_friction"].shape[:-1]
        common = drawn["friction"] if has_all else np.ones((*leading, 1))
        # The last one is for what is of no end effector, the owner -1.
        own = np.concatenate([drawn["pad_friction"] if has_pads else np.ones((*leading, len(carried))),
                              np.ones((*leading, 1))], axis=-1)  # fmt: skip
        for frictions, owners in rows:
            frictions.scale(common * own[..., owners], copies)

    vary.write_with(write)


def add_drives(vary: Variation, robots: Sequence[RobotPlacement]) -> None:
    """Vary damping of joints, gains of the arms' servos, and the force of end effectors."""
    world, model = vary.world, vary.world.model
    is_robots = np.zeros(model.nbody, np.bool_)
    for robot in robots:
        is_robots |= world.subtree(robot.base_body)
    dofs = np.flatnonzero(is_robots[model.dof_bodyid] & (model.dof_damping > 0))
    if vary.enable("joint_damping", (len(dofs),), [model.joint(model.dof_jntid[i]).name for i in dofs]):
        dampings = ModelRows(world, "dof_damping", dofs)
        vary.write_with(lambda drawn, copies: dampings.scale(drawn["joint_damping"], copies))
    layouts = [RobotLayout.of(robot, model) for robot in robots]
    _add_servos(vary, [i for layout in layouts for i in layout.actuator_ids])
    _add_grippers(vary, [robot.name for robot in robots], layouts)


def _add_servos(vary: Variation, servos: Sequence[int]) -> None:
    names = [vary.world.model.actuator(i).name for i in servos]
    fields = [field for field in ("servo_stiffness", "servo_damping") if vary.enable(field, (len(servos),), names)]
    if not fields:
        return
    # A servo's force is gainprm[0] * target + biasprm[1] * position + biasprm[2] * velocity.
    gains, biases = (ModelRows(vary.world, f"actuator_{kind}prm", servos) for kind in ("gain", "bias"))

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


def _add_grippers(vary: Variation, robots: Sequence[str], layouts: Sequence[RobotLayout]) -> None:
    model = vary.world.model
    drives = [[*one.hand_actuator_ids, *([one.finger_actuator] if one.finger_actuator >= 0 else [])] for one in layouts]
    moved = [i for i, own in enumerate(drives) if own]
    if not vary.enable("gripper_force", (len(moved),), [robots[i] for i in moved]):
        return
    rows = {
        field: [drives[i] for i in moved] for field in ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
    }
    rows["jnt_actfrcrange"] = [
        [
            joint
            for joint in (*layouts[i].finger_joint_ids, *layouts[i].hand_joint_ids)
            if model.jnt_actfrclimited[joint]
        ]
        for i in moved
    ]
    scaled = [
        (ModelRows(vary.world, field, np.concatenate(own).astype(np.intp)),
         np.repeat(np.arange(len(own)), [len(one) for one in own]))
        for field, own in rows.items()
    ]  # fmt: skip

    def write(drawn: dict[str, Values], copies: Copies) -> None:
        for values, owner in scaled:
            if len(owner):
                values.scale(drawn["gripper_force"][..., owner], copies)

    vary.write_with(write)


def add_table(vary: Variation) -> None:
    """Vary the height of the table; tasks put their objects on it."""
    world = vary.world
    table = mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_BODY, TABLE)
    if table < 0 or not vary.enable("table_height", (1,), [TABLE]):
        return
    vary.changes_constants = True
    rows = ModelRows(world, "body_pos", [table])

    def write(drawn: dict[str, Values], copies: Copies) -> None:
        height = drawn["table_height"]
        rows.write(rows.nominal + np.stack([np.zeros_like(height)] * 2 + [height], axis=-1), copies)

    vary.write_with(write)


def add_latency(vary: Variation, robots: Sequence[RobotPlacement]) -> ActionLatency | None:
    """Vary the latency of actions, the same for all robots; return what delays them."""
    if not vary.ranges.varies("action_latency") or not robots:
        return None
    latency = ActionLatency(vary.world, robots)
    vary.enable("action_latency", (1,), ["all robots"], finish=latency.whole_steps)
    vary.write_with(lambda drawn, copies: latency.write(drawn["action_latency"], copies))
    return latency
