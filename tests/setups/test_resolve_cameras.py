"""Cameras in a robot's own model file see what MuJoCo's camera there sees, in the frame that all cameras have here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

import rcs
from rcs._core import Renderer
from rcs.envs.assemble import assemble, compose
from rcs.envs.parts import Parts
from rcs.errors import InvalidSetup, UnknownName
from rcs.robots import FR3
from rcs.robots.description import ArmDescription
from rcs.setups.make import resolve
from rcs.setups.resolve import cameras_of, devices_of


def add_cameras(spec: mujoco.MjSpec) -> None:
    """Add cameras as files have them: one on a link, one beside the robot, one of a sensor, and one without a name."""
    link = spec.body("link5")
    link.add_camera(name="eye", pos=[0.0, 0.1, 0.05], quat=[0.9, 0.1, 0.4, 0.1], fovy=63.0)
    link.add_camera(name="sensor", resolution=[640, 480], focal_length=[0.003, 0.003], sensor_size=[0.004, 0.003])
    link.add_camera()
    spec.worldbody.add_camera(name="beside", pos=[1.5, -0.8, 0.9], quat=[0.8, 0.45, 0.2, 0.35])


WITH_EYE = replace(FR3, name="with_eye", complete=add_cameras)


def parts_with(change: Callable[[mujoco.MjSpec], None], *names: str, **options: Any) -> Parts:
    """Return the parts of an environment whose arm has another model file, seen by cameras of that."""
    setup = rcs.Setup(**options)
    parts = resolve(setup)
    robots = tuple(replace(robot, arm=_changed(robot.arm, change)) for robot in parts.robots)
    found = cameras_of(robots)
    return replace(
        parts,
        setup=replace(setup, cameras=replace(setup.cameras, names=names)),
        robots=robots,
        cameras=tuple(map(found.get, names)),
    )


def _changed(arm: ArmDescription, change: Callable[[mujoco.MjSpec], None]) -> ArmDescription:
    return replace(arm, complete=change)


def test_all_cameras_with_a_name_are_found() -> None:
    robots = parts_with(add_cameras).robots
    assert set(cameras_of(robots)) == {"eye", "sensor", "beside"}
    assert cameras_of(resolve(rcs.Setup()).robots) == {}


def test_with_several_robots_their_names_come_first() -> None:
    robots = parts_with(add_cameras, task="LiftBar", robot="dual_fr3").robots
    names = {"eye", "sensor", "beside"}
    assert set(cameras_of(robots)) == {f"{side}_{name}" for side in ("left", "right") for name in names}


@pytest.mark.parametrize("name", ["eye", "sensor", "beside"])
@pytest.mark.parametrize("options", [{}, {"robot": "dual_fr3", "task": "LiftBar"}], ids=["one robot", "two robots"])
def test_the_optical_frame_is_that_of_the_camera_in_the_file(name: str, options: dict[str, Any]) -> None:
    prefix = "right_" if options else ""
    robot = "right" if options else "fr3"
    model = compose(parts_with(add_cameras, prefix + name, **options)).compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for joint in range(7):
        data.joint(f"{robot}/joint{joint + 1}").qpos[0] = rng.uniform(-1.0, 1.0)
    mujoco.mj_forward(model, data)
    camera, body = data.camera(f"{robot}/{name}"), data.body(f"{prefix}{name}/optical")
    np.testing.assert_allclose(body.xpos, camera.xpos, atol=1e-12)
    np.testing.assert_allclose(body.xmat.reshape(3, 3), camera.xmat.reshape(3, 3) @ np.diag([1, -1, -1]), atol=1e-12)
    own, drawn = model.camera(f"{robot}/{name}").fovy[0], model.camera(f"{prefix}{name}/camera").fovy[0]
    np.testing.assert_allclose(drawn, own, rtol=1e-12)
    if name == "sensor":
        np.testing.assert_allclose(own, np.degrees(2 * np.arctan(0.003 / 2 / 0.003)))


def test_a_camera_of_the_file_adds_neither_mass_nor_anything_that_is_seen() -> None:
    without, with_camera = (compose(parts_with(add_cameras, *names)).compile() for names in ((), ("eye", "beside")))
    assert with_camera.body_mass.sum() == without.body_mass.sum()
    assert with_camera.ngeom == without.ngeom


def test_a_camera_that_turns_by_itself_or_is_off_its_axis_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="turns by itself"):
        parts_with(_track)
    with pytest.raises(InvalidSetup, match="principal point"):
        parts_with(_shifted)


def _track(spec: mujoco.MjSpec) -> None:
    spec.body("link5").add_camera(name="eye", mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK)


def _shifted(spec: mujoco.MjSpec) -> None:
    size = {"resolution": [640, 480], "focal_length": [0.003, 0.003], "sensor_size": [0.004, 0.003]}
    spec.body("link5").add_camera(name="eye", principal_length=[0.0002, 0.0], **size)


@pytest.mark.gl
def test_its_frames_are_those_that_mujocos_camera_in_the_file_draws() -> None:
    parts = parts_with(add_cameras, "eye", "beside", cameras=rcs.Cameras(image_size=(64, 48), depth=True))
    env = assemble(parts)
    observation, _ = env.reset(seed=0)
    world = env.simulation.world
    renderer = Renderer(world.model, quality="fast", max_width=64, max_height=48, is_rasterised=True)
    assert world.data is not None
    renderer.update(world.data)
    for name in ("eye", "beside"):
        rgb, depth = np.empty((48, 64, 3), np.uint8), np.empty((48, 64), np.uint16)
        renderer.render(world.model.camera(f"fr3/{name}").id, rgb, depth)
        frame = observation["frames"][name]
        np.testing.assert_array_equal(frame["rgb"], rgb)
        np.testing.assert_array_equal(frame["depth"], depth)
        pose = world.data.camera(f"fr3/{name}")
        np.testing.assert_allclose(frame["extrinsics"][:3, 3], pose.xpos, atol=1e-9)
        focal = 24 / np.tan(np.radians(world.model.camera(f"fr3/{name}").fovy[0]) / 2)
        np.testing.assert_allclose(frame["intrinsics"][0, 0], focal)
    renderer.close()
    env.close()


def _add_small_cameras(spec: mujoco.MjSpec) -> None:
    size = {"resolution": [64, 48], "focal_length": [0.003, 0.003], "sensor_size": [0.004, 0.003]}
    spec.worldbody.add_camera(name="beside", pos=[1.5, -0.8, 0.9], quat=[0.8, 0.45, 0.2, 0.35], **size)
    spec.body("forearm_link").add_camera(name="link", **size)


@pytest.mark.parametrize("end_effector", ["robotiq_2f85", "none"])
def test_a_real_camera_of_the_file_has_its_pose_on_the_base_and_none_on_a_link(end_effector: str) -> None:
    parts = parts_with(
        _add_small_cameras,
        "beside",
        "link",
        task="Free",
        robot="ur5e",
        end_effector=end_effector,
        stepping="realtime",
        cameras=rcs.Cameras(image_size=(64, 48)),
    )
    devices = devices_of({"beside": "fake", "link": "fake"}, parts)
    with assemble(replace(parts, devices=devices)) as env:
        frames = env.reset(seed=0)[0]["frames"]
    pose = parts.cameras[0].optical_in_parent.pose
    np.testing.assert_allclose(frames["beside"]["extrinsics"], pose.matrix, atol=1e-9)
    np.testing.assert_allclose(pose.translation, [1.5, -0.8, 0.9])
    assert frames["link"].keys() == {"rgb", "intrinsics", "distortion"}


@pytest.mark.parametrize("mode", ["large", "320x240"])
def test_a_mode_that_a_camera_of_the_file_does_not_have_is_refused(mode: str) -> None:
    setup = rcs.Setup("Free", robot=WITH_EYE, cameras=rcs.Cameras("sensor", mode=mode))
    with pytest.raises(UnknownName, match=r"mode of sensor named .* Known: 640x480\."):
        resolve(setup)
    resolve(replace(setup, cameras=rcs.Cameras("sensor", mode="640x480")))


@pytest.mark.parametrize(("wanted", "opened"), [((1024, 768), (1280, 720)), ((224, 224), (424, 240))])
def test_a_real_camera_is_opened_in_the_smallest_mode_that_is_large_enough_or_else_in_the_largest(
    wanted: tuple[int, int], opened: tuple[int, int]
) -> None:
    parts = resolve(rcs.Setup(cameras=rcs.Cameras(names=("wrist",), image_size=wanted)))
    mode = devices_of({"wrist": "fake:1"}, parts).cameras["wrist"].mode
    assert (mode.width, mode.height) == opened
