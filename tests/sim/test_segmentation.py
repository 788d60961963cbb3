"""Segmentation names what each pixel shows: as rays do that are cast into the scene, in every copy and on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.devices import lookup
from rcs.envs.observers.record import record
from rcs.errors import InvalidSetup
from rcs.hardware import Site
from rcs.setups.lab import lab_of
from rcs.sim.camera import Labels
from rcs.testing.env_contract import require_same_bits

pytestmark = pytest.mark.gl

SIZE = (112, 84)
DRAWN = np.array([1, 1, 1, 0, 0, 0], np.uint8)
WHOLE: Any = {"segmentation": True, "depth": True, "image_size": SIZE}


def rays_of(frame: dict[str, Any], eye: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the direction in the scene of every pixel, (H·W, 3); `eye` is the camera's rotation, OpenCV axes."""
    matrix = frame["intrinsics"]
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]].reshape(2, -1)
    x, y = (columns - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1]
    return np.stack([x, y, np.ones(x.size)], axis=1) @ eye.T


def cast(env: rcs.envs.Env, camera: str, frame: dict[str, Any]) -> np.ndarray[Any, Any]:
    """Return the number in `geoms` of what a ray through each pixel hits, (H, W)."""
    model, data = env.simulation.world.model, env.simulation.world.data
    assert data is not None
    number = next(i for i in range(model.ncam) if model.camera(i).name.startswith(f"{camera}/"))
    rays = np.ascontiguousarray(rays_of(frame, data.cam_xmat[number].reshape(3, 3) * [1, -1, -1]))
    hit, distance = np.empty(len(rays), np.int32), np.empty(len(rays))
    start, body = data.cam_xpos[number], int(model.cam_bodyid[number])
    mujoco.mj_multiRay(
        model, data, start, rays.ravel(), DRAWN, 1, body, hit, distance, None, len(rays), mujoco.mjMAXVAL
    )
    found = hit + 1
    for flex in range(model.nflex):
        middle = data.flexvert_xpos.mean(axis=0)
        near = np.linalg.norm(np.cross(rays, middle - start), axis=1) / np.linalg.norm(rays, axis=1) < 0.1
        for i in np.flatnonzero(near):
            reach = mujoco.mj_rayFlex(model, data, 0, False, False, True, True, flex, start, rays[i])
            if 0 <= reach < (distance[i] if distance[i] >= 0 else np.inf):
                found[i] = model.ngeom + flex + 1
    return found.reshape(SIZE[::-1])


@pytest.mark.parametrize("quality", ["fast", "full"])
@pytest.mark.parametrize("robot", lookup.names("lab"))
def test_every_pixel_of_every_lab_is_what_a_ray_hits(robot: str, quality: Any) -> None:
    lab = lab_of(robot)
    task = "PickToy" if robot == "fr3" else "LiftBar" if len(lab.stands) == 2 else "Free"
    env = rcs.make(
        task,
        robot=robot,
        cameras=rcs.Cameras(names=tuple(lab.cameras), segmentation=True, image_size=SIZE),
        render_quality=quality,
    )
    observation, _ = env.reset(seed=3)
    assert env.observation_space.contains(observation)
    labels = env.stack.about["labels"]
    table = np.array(labels["instance_of_geom"])
    for camera, frame in observation["frames"].items():
        expected = cast(env, camera, frame)
        assert (frame["geoms"] == expected).mean() >= 0.995, camera
        assert (frame["segmentation"] == table[expected]).mean() >= 0.995, camera
        assert len(np.unique(frame["segmentation"])) > 2
    if task == "PickToy":
        shown = observation["frames"]["side"]["segmentation"] == labels["instances"].index("toy")
        colour = observation["frames"]["side"]["rgb"].astype(int)
        assert shown.sum() > 20
        assert (colour[shown][:, 0] > colour[shown][:, 2] + 30).mean() > 0.9, "the toy is orange"
    env.close()


def test_names_tell_robots_end_effectors_objects_and_cameras_apart() -> None:
    env = rcs.make("PickCuboid", robot="fr3", cameras=rcs.Cameras("side", **WHOLE))
    model = env.simulation.world.model
    labels = Labels(model)
    assert {"table", "cuboid", "fr3", "fr3/gripper", "side", "floor"} <= set(labels.instances)
    assert labels.instances[0] == labels.geoms[0] == "background"
    assert len(labels.geoms) == model.ngeom + model.nflex + model.nskin + model.ntendon + 1
    geoms = np.arange(len(labels.geoms), dtype=np.uint16)
    for geom, instance in zip(geoms[1 : model.ngeom + 1], labels.instances_of(geoms)[1:], strict=False):
        body = model.body(model.geom_bodyid[geom - 1]).name
        if body.startswith("fr3/link"):
            assert labels.instances[instance] == "fr3"
    env.close()


def test_noise_changes_colours_and_depth_and_never_segmentation() -> None:
    frames = []
    for noise in (False, True):
        env = rcs.make("PickCuboid", cameras=rcs.Cameras(names=("side",), noise=noise, **WHOLE))
        frames.append(env.reset(seed=1)[0]["frames"]["side"])
        env.close()
    clean, noisy = frames
    for key in ("segmentation", "geoms"):
        np.testing.assert_array_equal(clean[key], noisy[key])
    for key in ("rgb", "depth"):
        assert not np.array_equal(clean[key], noisy[key])


def test_a_copy_has_the_segmentation_of_the_single_environment() -> None:
    options: dict[str, Any] = {
        "cameras": rcs.Cameras(names=("wrist", "side"), points=True, **WHOLE),
        "randomisation": True,
    }
    single, batch = rcs.make("PickCuboid", **options), rcs.make_vec("PickCuboid", copies=3, **options)
    one, many = single.reset(seed=6)[0]["frames"], batch.reset(seed=5)[0]["frames"]
    require_same_bits(one, {name: {key: value[1] for key, value in part.items()} for name, part in many.items()})
    assert {"rgb", "depth", "segmentation", "geoms", "points"} <= set(one["side"])
    single.close()
    batch.close()


def test_the_colours_and_depth_beside_segmentation_are_those_without_it() -> None:
    frames = []
    for segmentation in (False, True):
        env = rcs.make(
            "PickCuboid", cameras=rcs.Cameras(names=("side",), depth=True, segmentation=segmentation, image_size=SIZE)
        )
        frames.append(env.reset(seed=1)[0]["frames"]["side"])
        env.close()
    for key, values in frames[0].items():
        np.testing.assert_array_equal(values, frames[1][key])


def test_recordings_have_segmentation_bit_for_bit_and_its_names(tmp_path: Path) -> None:
    env = rcs.make("PickCuboid", cameras=rcs.Cameras(names=("side",), points=True, **WHOLE))
    seen = []
    with record(env, tmp_path / "takes") as takes:
        takes.start(at_reset=True)
        seen.append(env.reset(seed=0)[0])
        for _ in range(4):
            seen.append(env.step({"joints": np.full(7, 0.02), "gripper": np.ones(1, np.float32)})[0])
        takes.finish(None)
    about = env.stack.about
    env.close()
    dataset = Dataset.open(tmp_path / "takes")
    for key in ("segmentation", "geoms"):
        stored = np.stack(list(dataset.episodes[0].frames(f"observation/frames/side/{key}")))
        np.testing.assert_array_equal(stored, [one["frames"]["side"][key] for one in seen])
    assert dataset.info.origin["labels"] == about["labels"]
    assert not [feature.key for feature in dataset.info.features if "points" in feature.key]
    episode = dataset.episodes[0]
    depth = np.stack(list(episode.frames("observation/frames/side/depth")))
    camera = [episode.column(f"observation/frames/side/{key}") for key in ("intrinsics", "extrinsics", "distortion")]
    points = rcs.spatial.deproject(depth, camera[0], camera[1], distortion=camera[2], invalid=0.0)
    np.testing.assert_array_equal(points, [one["frames"]["side"]["points"] for one in seen])


def test_real_cameras_are_refused_segmentation() -> None:
    with pytest.raises(InvalidSetup, match="no segmentation"):
        rcs.make(
            "Free",
            cameras=rcs.Cameras(names=("side",), segmentation=True),
            hardware=Site(arms={"fr3": "fake"}, cameras={"side": "fake"}),
        )
