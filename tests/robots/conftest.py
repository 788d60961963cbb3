"""Scenes and published figures that the robot tests share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.robots.description import GripperDescription, Mount
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.spatial import Pose
from tests.robots.published import read_figures


@pytest.fixture(scope="session")
def figures() -> dict[str, Any]:
    """The published figures that the models must reproduce."""
    return read_figures("franka")


@pytest.fixture(scope="session")
def fr3() -> mujoco.MjModel:
    """The arm alone."""
    return mujoco.MjModel.from_xml_path(str(FR3.mjcf))


@pytest.fixture(scope="session")
def hand() -> mujoco.MjModel:
    """The hand alone."""
    return mujoco.MjModel.from_xml_path(str(FRANKA_HAND.mjcf))


@pytest.fixture(scope="session")
def lab() -> mujoco.MjModel:
    """An arm with a hand in empty space; prefixes `arm/` and `hand/`."""
    return _compose()


@pytest.fixture(scope="session")
def lab_with_cuboid() -> mujoco.MjModel:
    """The same with a cuboid of 64 x 32 x 57.6 mm and 60 g, body and joint `cuboid`."""
    return _compose(cuboid_mass=0.06)


@pytest.fixture(scope="session")
def at_home() -> Callable[[mujoco.MjModel], mujoco.MjData]:
    """Give data of a composed scene: the arm at home and held there by its servos, the hand open."""

    def make(model: mujoco.MjModel) -> mujoco.MjData:
        data = mujoco.MjData(model)
        for joint, actuator, q in zip(FR3.joints, FR3.actuators, FR3.home, strict=True):
            data.joint(f"arm/{joint}").qpos[0] = q
            data.actuator(f"arm/{actuator}").ctrl[0] = q
        for joint, q in zip(FRANKA_HAND.joints, FRANKA_HAND.joint_open, strict=True):
            data.joint(f"hand/{joint}").qpos[0] = q
        data.actuator(f"hand/{FRANKA_HAND.actuator}").ctrl[0] = FRANKA_HAND.ctrl_open
        mujoco.mj_forward(model, data)
        return data

    return make


@pytest.fixture(scope="session")
def inertia_in_body() -> Callable[[mujoco.MjModel, str], NDArray[np.float64]]:
    """Give a body's inertia about its centre of mass in body axes as xx yy zz xy xz yz [kg m^2]."""

    def compute(model: mujoco.MjModel, body: str) -> NDArray[np.float64]:
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.body(body).iquat)
        r = rotation.reshape(3, 3)
        matrix = r @ np.diag(model.body(body).inertia) @ r.T
        return matrix[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]

    return compute


@pytest.fixture(scope="session")
def above_a_cuboid() -> Callable[..., tuple[mujoco.MjModel, mujoco.MjData]]:
    """Put an open gripper, pointing down on a vertical slide, over a cuboid on a floor; the TCP at the cuboid's centre.

    The slide's servo is `lift` [m], the gripper's prefix is `gripper/`, body and joint of the cuboid are `cuboid`.
    """

    def make(
        gripper: GripperDescription,
        edges: tuple[float, float, float],
        mass: float,
        offset: tuple[float, float] = (0.0, 0.0),
    ) -> tuple[mujoco.MjModel, mujoco.MjData]:
        spec = mujoco.MjSpec()
        spec.option.timestep = 0.002
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = 20.0
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 0.1])
        down = Pose((0.0, 0.0, edges[2] / 2), (1.0, 0.0, 0.0, 0.0))
        base = down * Pose(gripper.tcp_in_base.translation, gripper.tcp_in_base.quaternion).inverse()
        x, y, z, w = base.quaternion
        carriage = spec.worldbody.add_body(mass=1.0, inertia=[0.01] * 3, explicitinertial=True, gravcomp=1.0)
        carriage.add_joint(name="lift", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0])
        frame = carriage.add_frame(pos=base.translation, quat=[w, x, y, z])
        spec.attach(mujoco.MjSpec.from_file(str(gripper.mjcf)), prefix="gripper/", frame=frame)
        lift = spec.add_actuator(name="lift", target="lift", trntype=mujoco.mjtTrn.mjTRN_JOINT)
        lift.set_to_position(kp=20000.0, kv=1000.0)
        body = spec.worldbody.add_body(name="cuboid", pos=[*offset, edges[2] / 2])
        body.add_freejoint(name="cuboid")
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[edge / 2 for edge in edges],
            mass=mass,
            condim=4,
            friction=[1.0, 0.01, 0.0001],
        )
        model = spec.compile()
        data = mujoco.MjData(model)
        for joint, q in zip(gripper.joints, gripper.joint_open, strict=True):
            data.joint(f"gripper/{joint}").qpos[0] = q
        data.actuator(f"gripper/{gripper.actuator}").ctrl[0] = gripper.ctrl_open
        mujoco.mj_forward(model, data)
        return model, data

    return make


def _compose(cuboid_mass: float | None = None) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.002
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    spec.attach(mujoco.MjSpec.from_file(str(FR3.mjcf)), prefix="arm/", frame=spec.worldbody.add_frame())
    flange = spec.site(f"arm/{FR3.flange_site}")
    mount = FRANKA_HAND.mount_in_flange
    frame = flange.parent.add_frame(pos=flange.pos + np.array(mount.translation), quat=_wxyz(mount))
    spec.attach(mujoco.MjSpec.from_file(str(FRANKA_HAND.mjcf)), prefix="hand/", frame=frame)
    if cuboid_mass is not None:
        body = spec.worldbody.add_body(name="cuboid")
        body.add_freejoint(name="cuboid")
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.032, 0.016, 0.0288], mass=cuboid_mass)
    return spec.compile()


def _wxyz(mount: Mount) -> list[float]:
    x, y, z, w = mount.quaternion
    return [w, x, y, z]
