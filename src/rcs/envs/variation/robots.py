"""The robots, varied from episode to episode: drives, grippers, latency; and the height of the table."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from rcs.envs.variation.variation import Values, Variation
from rcs.sim.action_latency import ActionLatency
from rcs.sim.layout import RobotLayout
from rcs.sim.model_rows import ModelRows
from rcs.sim.scene import TABLE, RobotPlacement
from rcs.sim.world import Copies


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
    servos = [i for layout in layouts for i in layout.actuator_ids]
    _add_servos(vary, [i for i in servos if model.actuator_biastype[i] != mujoco.mjtBias.mjBIAS_NONE])
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
