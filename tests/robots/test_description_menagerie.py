"""Where the meshes of `mujoco-menagerie` go on the built-in bodies, which each description says as data."""

from __future__ import annotations

import os

import mujoco
import numpy as np
import pytest

from rcs._core import Renderer
from rcs.devices import lookup
from rcs.kinematics import load
from rcs.robots.description import ArmDescription, GripperDescription, Mount
from rcs.sim.detail import exchange_visuals
from rcs.spatial import Pose

Robot = ArmDescription | GripperDescription

MAPPED: list[Robot] = [
    part
    for kind in ("arm", "gripper")
    for name in lookup.names(kind)
    if isinstance(part := lookup.find(kind, name), Robot) and part.menagerie is not None
]
"""All arms and grippers that are installed and have meshes in the collection."""


@pytest.fixture(params=MAPPED, ids=lambda part: part.name)
def robot(request: pytest.FixtureRequest) -> Robot:
    """An arm or a gripper with meshes in the collection."""
    return request.param


@pytest.fixture
def real_meshes() -> None:
    """Skip where the package or its models are not there; tests download nothing."""
    pytest.importorskip("mujoco_menagerie", reason="mujoco-menagerie is not installed")
    if "MENAGERIE_ROOT" not in os.environ:
        pytest.skip("MENAGERIE_ROOT is not set to a folder with models of mujoco_menagerie")


def test_all_bodies_that_get_meshes_are_in_the_built_in_model(robot: Robot) -> None:
    assert robot.menagerie is not None
    spec = load(robot)
    for body in robot.menagerie.bodies:
        assert spec.body(body.body) is not None, body.body
    assert len(set(robot.menagerie.bodies)) == len(robot.menagerie.bodies)


@pytest.mark.extras
def test_frames_of_the_real_meshes_agree_with_the_built_in_bodies(robot: Robot, real_meshes: None) -> None:
    import mujoco_menagerie

    visuals = robot.menagerie
    assert visuals is not None
    is_alike = all(body.source_in_body == Mount() for body in visuals.bodies)
    # A gripper whose frames differ is put together in another way: it agrees where all its joints are at zero.
    is_moved = is_alike or isinstance(robot, ArmDescription)
    ours = mujoco.MjData(load(robot).compile())
    theirs = mujoco.MjData(mujoco_menagerie.get(visuals.model).spec(visuals.entry).compile())
    rng = np.random.default_rng(2)
    for _ in range(10):
        for body in visuals.bodies:
            own, source = ours.model.body(body.body), theirs.model.body(body.source)
            if is_moved and own.jntnum[0]:
                q = rng.uniform(*ours.model.jnt_range[own.jntadr[0]])
                ours.qpos[ours.model.jnt_qposadr[own.jntadr[0]]] = q
                theirs.qpos[theirs.model.jnt_qposadr[source.jntadr[0]]] = q
        mujoco.mj_kinematics(ours.model, ours)
        mujoco.mj_kinematics(theirs.model, theirs)
        first = visuals.bodies[0]
        for body in visuals.bodies:
            one = relative(pose(theirs, first.source), pose(theirs, body.source))
            two = relative(
                pose(ours, first.body) @ matrix(first.source_in_body),
                pose(ours, body.body) @ matrix(body.source_in_body),
            )
            # The collection rounds some lengths: of the UR5e to millimetres.
            np.testing.assert_allclose(one, two, atol=1e-9 if is_alike else 2.5e-3, err_msg=body.body)


def pose(data: mujoco.MjData, body: str) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3] = data.body(body).xmat.reshape(3, 3)
    found[:3, 3] = data.body(body).xpos
    return found


def matrix(mount: Mount) -> np.ndarray:
    return np.asarray(Pose(mount.translation, mount.quaternion).matrix)


def relative(base: np.ndarray, tip: np.ndarray) -> np.ndarray:
    return np.linalg.inv(base) @ tip


@pytest.mark.gl
@pytest.mark.extras
@pytest.mark.parametrize("direction", [(1.0, 0.1, 0.1), (0.1, -1.0, 0.1), (0.6, -0.6, 0.5)])
def test_the_real_meshes_cover_the_built_in_primitives(
    robot: Robot, real_meshes: None, direction: tuple[float, ...]
) -> None:
    stat = load(robot).compile().stat
    eye = stat.center + 1.3 * stat.extent * np.array(direction)
    one, two = (silhouette(robot, is_detailed, eye, stat.center) for is_detailed in (False, True))
    assert one.mean() > 0.03
    assert (one & two).sum() / (one | two).sum() > 0.6


def silhouette(robot: Robot, is_detailed: bool, eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return where a picture of a robot at home shows it: wherever there is anything at all."""
    spec = load(robot)
    if is_detailed:
        assert exchange_visuals(spec, [("", robot.menagerie)])
    spec.worldbody.add_body(name="target", pos=target)
    spec.worldbody.add_camera(
        name="eye", pos=eye, mode=mujoco.mjtCamLight.mjCAMLIGHT_TARGETBODY, targetbody="target", fovy=45
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    if isinstance(robot, ArmDescription):
        data.qpos[[model.joint(name).qposadr[0] for name in robot.joints]] = robot.home
    mujoco.mj_forward(model, data)
    depth = np.empty((240, 320), np.uint16)
    renderer = Renderer(model, quality="fast", max_width=320, max_height=240)
    renderer.update(data)
    renderer.render(model.camera("eye").id, np.empty((240, 320, 3), np.uint8), depth)
    renderer.close()
    return depth > 0
