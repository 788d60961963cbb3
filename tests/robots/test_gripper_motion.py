"""Grippers and hands: how fast they move, whose friction acts on what they hold, and what they lift."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from rcs.robots import FRANKA_HAND, ROBOTIQ_2F85, SO101_GRIPPER, TILBURG_HAND
from rcs.robots.description import GripperDescription

AboveACuboid = Callable[..., tuple[mujoco.MjModel, mujoco.MjData]]

GRIPPERS = (FRANKA_HAND, ROBOTIQ_2F85, SO101_GRIPPER)
DATA_SHEET = {
    # Franka Hand product manual 1.2: 50 mm/s per finger. 2F-85 data sheet: the opening closes with 20 to 150 mm/s.
    "franka_hand": 0.05,
    "robotiq_2f85": 0.075,
    # STS3215 at 12 V without load: 45 rpm, at the 80 mm from the jaw's axis to its tip.
    "so101_gripper": 1.5 * np.pi * 0.0807,
}
"""Largest speed of a finger [m/s]."""
TILBURG_SPEED = 8.0
"""Largest speed of a joint in the vendor's URDF [rad/s]."""


def alone(path: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_path(path)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("gripper", GRIPPERS, ids=lambda gripper: gripper.name)
def test_no_finger_is_faster_than_its_data_sheet_and_in_the_middle_of_its_way_it_is_about_as_fast_as_described(
    gripper: GripperDescription,
) -> None:
    model, data = alone(str(gripper.mjcf))
    pads = [model.geom(name).id for names in gripper.pad_geoms for name in names]
    for joint, q in zip(gripper.joints, gripper.joint_open, strict=True):
        data.joint(joint).qpos[0] = q
    peak = 0.0
    for ctrl in (gripper.ctrl_closed, gripper.ctrl_open):
        data.ctrl[0] = ctrl
        mujoco.mj_forward(model, data)
        before = data.geom_xpos[pads].copy()
        for _ in range(round(1.0 / model.opt.timestep)):
            mujoco.mj_step(model, data)
            mujoco.mj_kinematics(model, data)
            now = data.geom_xpos[pads].copy()
            peak = max(peak, float(np.linalg.norm(now - before, axis=1).max()) / model.opt.timestep)
            before = now
    assert peak < DATA_SHEET[gripper.name] * 1.01
    assert peak > 0.7 * gripper.closing_speed


def test_no_joint_of_the_tilburg_hand_is_faster_than_its_published_speed() -> None:
    model, data = alone(str(TILBURG_HAND.mjcf))
    peak = 0.0
    for target in (TILBURG_HAND.joint_upper, TILBURG_HAND.joint_lower):
        for name, q in zip(TILBURG_HAND.actuators, target, strict=True):
            data.actuator(name).ctrl[0] = q
        for _ in range(round(0.5 / model.opt.timestep)):
            mujoco.mj_step(model, data)
            peak = max(peak, float(np.abs(data.qvel).max()))
    assert 1.0 < peak < TILBURG_SPEED


@pytest.mark.parametrize("gripper", GRIPPERS, ids=lambda gripper: gripper.name)
@pytest.mark.parametrize("friction", [0.8, 1.0, 1.25])
def test_what_is_held_brings_its_own_friction_and_the_pads_their_stiffness(
    gripper: GripperDescription, friction: float, above_a_cuboid: AboveACuboid
) -> None:
    model, data = above_a_cuboid(gripper, (0.064, 0.032, 0.0576), 0.015)
    cuboid = model.body("cuboid").geomadr[0]
    model.geom_friction[cuboid, 0] = friction
    data.actuator(f"gripper/{gripper.actuator}").ctrl[0] = gripper.ctrl_closed
    mujoco.mj_step(model, data, nstep=700)
    pads = {model.geom(f"gripper/{name}").id: name for names in gripper.pad_geoms for name in names}
    contacts = [contact for contact in data.contact if pads.keys() & set(contact.geom.tolist())]
    assert {pad for contact in contacts for pad in pads if pad in contact.geom} == set(pads)
    for contact in contacts:
        assert contact.friction[0] == friction
        assert contact.dim == 4
        np.testing.assert_allclose(contact.solref, model.geom_solref[next(iter(pads))], rtol=0.05)


@pytest.mark.parametrize("gripper", GRIPPERS, ids=lambda gripper: gripper.name)
def test_a_slippery_cuboid_is_lost_where_one_that_grips_is_lifted(
    gripper: GripperDescription, above_a_cuboid: AboveACuboid
) -> None:
    # A quarter more than the pads' own friction can hold: only the cuboid's can.
    (first,), _ = gripper.pad_geoms
    pads = mujoco.MjModel.from_xml_path(str(gripper.mjcf)).geom(first).friction[0]
    mass = 2.0 * pads * gripper.grasp_force * 1.25 / 9.81
    heights = []
    for friction in (0.8 * pads, 2.0 * pads):
        model, data = above_a_cuboid(gripper, (0.064, 0.032, 0.0576), mass)
        model.geom_friction[model.body("cuboid").geomadr[0], 0] = friction
        data.actuator(f"gripper/{gripper.actuator}").ctrl[0] = gripper.ctrl_closed
        mujoco.mj_step(model, data, nstep=700)
        for step in range(500):
            data.actuator("lift").ctrl[0] = 0.1 * step / 500
            mujoco.mj_step(model, data)
        heights.append(float(data.body("cuboid").xpos[2]))
    assert heights[0] < 0.05
    assert heights[1] > 0.1


@pytest.mark.parametrize(
    ("gripper", "edges", "mass", "offset"),
    [(ROBOTIQ_2F85, (0.064, 0.032, 0.0576), 0.05, at) for at in ((0.0, 0.0), (0.004, 0.005), (-0.01, -0.012))]
    + [(SO101_GRIPPER, (0.040, 0.020, 0.036), 0.015, at) for at in ((0.0, 0.0), (0.005, -0.006))],
)
def test_a_cuboid_is_lifted_and_held_for_three_seconds(
    gripper: GripperDescription,
    edges: tuple[float, float, float],
    mass: float,
    offset: tuple[float, float],
    above_a_cuboid: AboveACuboid,
) -> None:
    model, data = above_a_cuboid(gripper, edges, mass, offset)
    data.actuator(f"gripper/{gripper.actuator}").ctrl[0] = gripper.ctrl_closed
    mujoco.mj_step(model, data, nstep=500 if gripper is ROBOTIQ_2F85 else 600)
    for step in range(250):
        data.actuator("lift").ctrl[0] = 0.15 * step / 250
        mujoco.mj_step(model, data)
    mujoco.mj_step(model, data, nstep=150)

    force, by_pad = np.zeros(6), {f"gripper/{name}": 0.0 for names in gripper.pad_geoms for name in names}
    for index, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, index, force)
        (pad,) = {model.geom(int(geom)).name for geom in contact.geom} & by_pad.keys()
        by_pad[pad] += force[0]
        assert contact.dist > -1e-3 or gripper is SO101_GRIPPER
    assert list(by_pad.values()) == pytest.approx([gripper.grasp_force] * 2, rel=0.1)

    held = data.body("cuboid").xpos - data.site("gripper/tcp").xpos
    mujoco.mj_step(model, data, nstep=1500)
    np.testing.assert_allclose(data.body("cuboid").xpos - data.site("gripper/tcp").xpos, held, atol=1e-3)
    assert data.body("cuboid").xpos[2] > 0.15
