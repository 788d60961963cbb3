"""Points that cameras see lie on what is there."""

from __future__ import annotations

import numpy as np
import pytest

import rcs
from rcs.envs.layers import PointClouds
from rcs.errors import InvalidSetup
from rcs.spatial import deproject, point_cloud


@pytest.mark.gl
@pytest.mark.parametrize("seed", [0, 1])
def test_points_of_the_cuboid_lie_within_a_millimetre_of_its_faces(seed: int) -> None:
    env = rcs.make(
        "PickCuboid",
        cameras=rcs.Cameras(names=("side", "wrist"), image_size=(640, 480), depth=True, segmentation=True, points=True),
        render_quality="full",
    )
    observation, _ = env.reset(seed=seed)
    assert env.observation_space.contains(observation)
    model, data = env.simulation.world.model, env.simulation.world.data
    assert data is not None
    number = env.stack.about["labels"]["instances"].index("cuboid")
    base = env.robots["fr3"].base_in_scene.pose.matrix
    cuboid, half = data.geom("cuboid"), model.geom("cuboid").size
    for name, frame in observation["frames"].items():
        mask = frame["segmentation"] == number
        points, colours = point_cloud(frame["depth"], frame["intrinsics"], frame["extrinsics"], frame["rgb"], mask)
        if name == "wrist" and not mask.any():
            continue  # it may be out of sight
        assert len(points) > 100, name
        in_scene = points @ base[:3, :3].T + base[:3, 3]
        beyond = np.abs((in_scene - cuboid.xpos) @ cuboid.xmat.reshape(3, 3)) - half
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        inside = np.maximum(-beyond.max(axis=1), 0.0)
        assert np.maximum(outside, inside).max() < 0.001, name
        assert colours is not None
        green = colours.astype(int)
        assert (green[:, 1] > green[:, 0]).mean() > 0.95
        np.testing.assert_array_equal(frame["points"][mask], points)
    env.close()


@pytest.mark.gl
def test_a_pixel_without_depth_has_no_point_and_all_others_that_of_the_function() -> None:
    env = rcs.make(
        "PickCuboid", cameras=rcs.Cameras(names=("side",), image_size=(64, 48), depth=True, points=True, noise=True)
    )
    frame = env.reset(seed=0)[0]["frames"]["side"]
    lost = frame["depth"] == 0
    assert 0 < lost.mean() < 0.3
    assert not frame["points"][lost].any()
    assert frame["points"][~lost].any(axis=-1).all()
    again = deproject(frame["depth"], frame["intrinsics"], frame["extrinsics"], distortion=frame["distortion"])
    np.testing.assert_array_equal(frame["points"][~lost], again[~lost])
    env.close()


@pytest.mark.gl
def test_several_robots_have_the_points_in_the_frame_of_the_scene() -> None:
    cameras = rcs.Cameras(names=("front",), image_size=(64, 48), depth=True, points=True, segmentation=True)
    env = rcs.make("LiftBar", robot="dual_fr3", cameras=cameras)
    frame = env.reset(seed=0)[0]["frames"]["front"]
    table = frame["geoms"] == env.stack.about["labels"]["geoms"].index("table top")
    top = frame["points"][table][:, 2]
    assert top.size > 100
    assert np.quantile(np.abs(top), 0.9) < 0.002
    env.close()


def test_a_camera_without_depth_or_frames_stays_as_it_is() -> None:
    layer = PointClouds()
    for observation in ({"joints": np.zeros(7)}, {"frames": {"side": {"rgb": np.zeros((2, 2, 3), np.uint8)}}}):
        mapped = layer.map_observation(observation)
        assert mapped.keys() == observation.keys()
        if "frames" in mapped:
            assert mapped["frames"]["side"].keys() == {"rgb"}


def test_points_of_a_real_camera_on_one_of_several_robots_are_refused() -> None:
    cameras = rcs.Cameras(names=("left_wrist",), image_size=(64, 48), depth=True, points=True)
    hardware = {"left": "fake:a", "right": "fake:b", "left_wrist": "fake:c"}
    with pytest.raises(InvalidSetup, match=r"\(left_wrist\) have no extrinsics"):
        rcs.make("Free", robot="dual_fr3", hardware=hardware, cameras=cameras)


def test_points_of_a_real_camera_that_stands_still_are_not() -> None:
    cameras = rcs.Cameras(names=("front",), image_size=(64, 48), depth=True, points=True)
    hardware = {"left": "fake:a", "right": "fake:b", "front": "fake:c"}
    rcs.make("Free", robot="dual_fr3", hardware=hardware, cameras=cameras).close()


def test_points_without_depth_are_refused() -> None:
    with pytest.raises(InvalidSetup, match="give depth=True"):
        rcs.Setup(cameras=rcs.Cameras(points=True))
