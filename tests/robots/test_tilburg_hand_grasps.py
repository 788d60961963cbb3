"""The Tilburg Hand lifts things from a table with a power grasp, its palm down."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.robots.tilburg_hand import TILBURG_HAND
from rcs.spatial import Pose

BALL, CAPSULE, ELLIPSOID = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_ELLIPSOID
STEP = 0.002
HEIGHT = 0.12
"""How far things are lifted [m]."""


def above(
    kind: mujoco.mjtGeom, size: list[float], height: float, mass: float, offset: tuple[float, float]
) -> mujoco.MjModel:
    """Put the hand on a vertical slide over a thing on a table; the slide is at 0 with the TCP on the table.

    Args:
        kind: Shape of the thing.
        size: Its size as MuJoCo wants it [m].
        height: Height of its centre above the table [m].
        mass: Its mass [kg].
        offset: Where it lies, relative to the TCP [m].
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 20.0
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 0.1])
    tcp = TILBURG_HAND.tcp_in_base
    base = Pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)) * Pose(tcp.translation, tcp.quaternion).inverse()
    x, y, z, w = base.quaternion
    carriage = spec.worldbody.add_body(mass=1.0, inertia=[0.01] * 3, explicitinertial=True, gravcomp=1.0)
    carriage.add_joint(name="lift", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0])
    spec.attach(
        mujoco.MjSpec.from_file(str(TILBURG_HAND.mjcf)),
        prefix="hand/",
        frame=carriage.add_frame(pos=base.translation, quat=[w, x, y, z]),
    )
    lift = spec.add_actuator(name="lift", target="lift", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    lift.set_to_position(kp=5000.0, kv=300.0)
    thing = spec.worldbody.add_body(name="thing", pos=[*offset, height])
    thing.add_freejoint(name="thing")
    thing.add_geom(name="thing", type=kind, size=[*size, 0.0, 0.0, 0.0][:3], mass=mass)
    return spec.compile()


def control(normalised: tuple[float, ...]) -> NDArray[np.float64]:
    """Joint positions [rad] of normalised ones."""
    lower, upper = np.array(TILBURG_HAND.joint_lower), np.array(TILBURG_HAND.joint_upper)
    return lower + np.array(normalised) * (upper - lower)


def touches_table(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Whether a part of the hand is on the table."""
    allowed = {model.geom("table").id, model.geom("thing").id}
    return any(model.geom("table").id in pair and not allowed.issuperset(pair) for pair in data.contact.geom)


@pytest.mark.parametrize(
    ("kind", "size", "height", "mass", "offset"),
    [
        pytest.param(BALL, [0.025], 0.025, 0.05, (0.0, 0.0), id="ball of 5 cm"),
        pytest.param(BALL, [0.025], 0.025, 0.1, (-0.01, 0.01), id="heavy ball off centre"),
        pytest.param(CAPSULE, [0.03, 0.03], 0.06, 0.08, (0.0, 0.0), id="standing capsule"),
        pytest.param(ELLIPSOID, [0.035, 0.04, 0.035], 0.035, 0.1, (0.01, -0.01), id="toy of 8 cm off centre"),
    ],
)
def test_a_power_grasp_lifts_it_and_holds_it_for_two_seconds(
    kind: mujoco.mjtGeom, size: list[float], height: float, mass: float, offset: tuple[float, float]
) -> None:
    model = above(kind, size, height, mass, offset)
    data = mujoco.MjData(model)
    fingers = [model.actuator(f"hand/{name}").id for name in TILBURG_HAND.actuators]
    start, goal = control(TILBURG_HAND.open_pose), control(TILBURG_HAND.grasps["power"])
    for joint, q in zip(TILBURG_HAND.joints, start, strict=True):
        data.joint(f"hand/{joint}").qpos[0] = q
    # The TCP at the centre of the thing; of one that stands high at most 4 cm up, above that the palm is in the way.
    grasp_height = min(height, 0.04)
    data.joint("lift").qpos[0] = data.actuator("lift").ctrl[0] = grasp_height

    for step in range(400):
        data.ctrl[fingers] = start + (goal - start) * min(1.0, step / 250)
        mujoco.mj_step(model, data)
        assert not touches_table(model, data)
    for step in range(400):
        data.actuator("lift").ctrl[0] = grasp_height + HEIGHT * min(1.0, step / 300)
        mujoco.mj_step(model, data)
    assert data.body("thing").xpos[2] > height + 0.8 * HEIGHT
    # Three fingers push the thumb back until its joints bear as much: what is held moves with them, and then rests.
    mujoco.mj_step(model, data, nstep=1000)
    held = data.body("thing").xpos.copy()
    mujoco.mj_step(model, data, nstep=1000)
    np.testing.assert_allclose(data.body("thing").xpos, held, atol=2e-3)
    names = {model.geom(int(geom)).name.removeprefix("hand/") for geom in np.ravel(data.contact.geom)}
    by_finger = {finger: names.intersection(geoms) for finger, geoms in TILBURG_HAND.finger_geoms.items()}
    assert by_finger["thumb"]
    assert sum(bool(touched) for touched in by_finger.values()) >= 2
