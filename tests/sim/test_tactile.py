"""A DIGIT that lies still, and one object that is put into its gel."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.robots.description import Mount
from rcs.robots.tactile import DIGIT
from rcs.sim import Scene, World
from rcs.sim.gel import Gel
from rcs.sim.tactile import SimTactile
from rcs.sim.tactile_mounts import TactilePlacement

TOUCH = TactilePlacement(
    name="touch",
    sensor=DIGIT,
    parent_body="world",
    sensor_in_parent=Mount(translation=(0.3, 0.1, 0.5), quaternion=(0.5, 0.5, 0.5, 0.5)),
)
TIP, _, MIDDLE = DIGIT.gel_center
GEL = Gel(DIGIT)
FOCAL = GEL.size[0] / (2.0 * math.tan(0.5 * DIGIT.camera_yfov))
"""Focal length of the sensor's camera [px]."""


def model_with(shape: mujoco.mjtGeom, size: Sequence[float]) -> mujoco.MjModel:
    """Return the sensor above a table, and a body `object` of one geom that floats freely."""
    scene = Scene.empty()
    scene.add_table()
    scene.add_tactile(TOUCH)
    body = scene.spec.worldbody.add_body(name="object", gravcomp=1.0, pos=[0.0, 0.0, 1.0])
    body.add_freejoint(name="object")
    body.add_geom(name="object", type=shape, size=[*size, *[0.0] * (3 - len(size))], mass=0.5)
    return scene.compile()


def ball_world(radius: float, **options: Any) -> World:
    """Return a world with the sensor and a ball."""
    return World(model_with(mujoco.mjtGeom.mjGEOM_SPHERE, [radius]), **options)


def put(world: World, place: Sequence[float], rotation: NDArray[np.float64] | None = None, copy: Any = ...) -> None:
    """Put the object at a place in the sensor's frame [m], turned by a rotation matrix in that frame."""
    address = world.model.jnt_qposadr[world.model.joint("object").id]
    mount = np.empty(9)
    x, y, z, w = TOUCH.sensor_in_parent.quaternion
    mujoco.mju_quat2Mat(mount, np.array([w, x, y, z]))
    turn = mount.reshape(3, 3)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, (turn @ (np.eye(3) if rotation is None else rotation)).ravel())
    world.qpos[copy, address : address + 3] = TOUCH.sensor_in_parent.translation + turn @ np.array(place)
    world.qpos[copy, address + 3 : address + 7] = quaternion
    world.refresh()


def press_ball(
    sensor: SimTactile, world: World, radius: float, depth: float, y: float = 0.0
) -> dict[str, NDArray[Any]]:
    """Put a ball so that its foremost point is `depth` behind the gel's foremost, and read the sensor."""
    put(world, [TIP - depth + radius, y, MIDDLE])
    return sensor.read()


def patch_radius(radius: float, depth: float) -> float:
    """Return where the surfaces of a ball and of the curved gel intersect [m]: the radius of the contact patch."""

    def gap(r: float) -> float:
        return TIP - depth + radius - math.sqrt(radius**2 - r**2) - float(GEL.surface(np.array(r), np.array(MIDDLE)))

    inside, outside = 0.0, radius
    for _ in range(60):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if gap(middle) < 0.0 else (inside, middle)
    return inside


def seen_radius(frame: NDArray[np.uint8], background: NDArray[np.uint8]) -> float:
    """Return the radius of what a press in the middle changed in a frame [px]: where half of the change is left.

    Nothing but the two pictures goes in. A ball's slope, and with it the change of colour, grows towards the edge of
    the contact; the skin, rounding the edge off, puts the greatest change inside of it and half of that at the edge.
    """
    change = np.abs(frame.astype(int) - background).sum(axis=2)
    rows, columns = np.indices(change.shape)
    distance = np.hypot(rows - (change.shape[0] - 1) / 2, columns - (change.shape[1] - 1) / 2)
    rings = np.array([change[(distance >= r - 0.5) & (distance < r + 0.5)].mean() for r in range(1, 118)])
    return 1.0 + float(np.flatnonzero(rings >= 0.5 * rings.max())[-1])


@pytest.fixture
def world() -> World:
    return ball_world(0.008)


@pytest.fixture
def sensor(world: World) -> SimTactile:
    return SimTactile(world, TOUCH, indentation="geometry")


@pytest.fixture
def background(world: World, sensor: SimTactile) -> NDArray[np.uint8]:
    put(world, [1.0, 0.0, 0.0])
    return sensor.read()["rgb"]


@pytest.mark.parametrize("radius", [0.002, 0.003, 0.004, 0.006, 0.01, 0.02])
@pytest.mark.parametrize("depth", [0.0004, 0.0008, 0.0012, 0.0016])
def test_the_patch_of_a_ball_has_the_radius_of_the_cap_that_is_inside_the_gel(radius: float, depth: float) -> None:
    world = ball_world(radius)
    sensor = SimTactile(world, TOUCH, indentation="geometry")
    put(world, [1.0, 0.0, 0.0])
    background = sensor.read()["rgb"]
    frame = press_ball(sensor, world, radius, depth)["rgb"]
    expected = patch_radius(radius, depth)
    distance = TIP - depth + radius - math.sqrt(radius**2 - expected**2)
    assert seen_radius(frame, background) * distance / FOCAL == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("depth", [0.0005, 0.001])
def test_on_a_flat_gel_the_patch_has_the_radius_of_a_spherical_cap(depth: float) -> None:
    # The same law without the gel's curvature: a ball that is small against it sees a flat gel.
    radius = 0.003
    assert patch_radius(radius, depth) == pytest.approx(math.sqrt(2 * radius * depth - depth**2), rel=0.05)
    world = ball_world(radius)
    sensor = SimTactile(world, TOUCH, indentation="geometry")
    put(world, [1.0, 0.0, 0.0])
    background = sensor.read()["rgb"]
    seen = seen_radius(press_ball(sensor, world, radius, depth)["rgb"], background) * TIP / FOCAL
    assert seen == pytest.approx(math.sqrt(2 * radius * depth - depth**2), rel=0.1)


def test_a_deeper_press_makes_a_larger_patch(world: World, sensor: SimTactile, background: NDArray[np.uint8]) -> None:
    depths = np.linspace(0.0001, 0.002, 8)
    readings = [press_ball(sensor, world, 0.008, depth) for depth in depths]
    pixels = [int((reading["rgb"] != background).any(axis=2).sum()) for reading in readings]
    assert pixels == sorted(set(pixels))
    deepest = [float(reading["indentation"].max()) for reading in readings]
    np.testing.assert_allclose(deepest, depths, atol=5e-6)  # the skin rounds off a little


def test_without_contact_every_bit_of_the_background_stays(
    world: World, sensor: SimTactile, background: NDArray[np.uint8]
) -> None:
    for depth in (-1e-5, -0.003):  # close by, but not inside
        reading = press_ball(sensor, world, 0.008, depth)
        np.testing.assert_array_equal(reading["rgb"], background)
        assert not reading["indentation"].any()


def test_far_from_a_contact_every_bit_of_the_background_stays(
    world: World, sensor: SimTactile, background: NDArray[np.uint8]
) -> None:
    frame = press_ball(sensor, world, 0.008, 0.0005)["rgb"]
    changed = np.argwhere((frame != background).any(axis=2)) - (119.5, 159.5)
    reach = patch_radius(0.008, 0.0005) + 0.003
    assert np.linalg.norm(changed, axis=1).max() < reach * FOCAL / TIP


def test_a_press_to_the_left_mirrors_one_to_the_right(world: World, sensor: SimTactile) -> None:
    left = press_ball(sensor, world, 0.008, 0.001, y=0.004)
    right = press_ball(sensor, world, 0.008, 0.001, y=-0.004)
    np.testing.assert_allclose(left["indentation"], right["indentation"][::-1], atol=1e-9)
    # The red and the green light are mirror images of each other as well.
    mirrored = right["rgb"][::-1][..., [1, 0, 2]]
    assert np.abs(left["rgb"].astype(int) - mirrored).max() <= 1
    assert left["indentation"][:120].max() > left["indentation"][120:].max()  # +y is up


def test_the_patch_is_where_the_ball_is(world: World, sensor: SimTactile) -> None:
    put(world, [TIP - 0.001 + 0.008, 0.003, MIDDLE + 0.005])
    felt = np.argwhere(sensor.read()["indentation"] > 3e-4).mean(axis=0)
    # On a dome, a ball that is off the middle touches between its own middle and the dome's.
    fall = float(TIP - GEL.surface(np.array(0.001), np.array(MIDDLE)))
    dome = 0.001**2 / (2 * fall)
    touched = np.array([0.003, 0.005]) * dome / (dome + 0.008) / TIP
    np.testing.assert_allclose(felt, GEL.pixels(touched[0], touched[1]), atol=4.0)


def test_a_deep_press_goes_no_deeper_than_the_gel_gives_in(world: World, sensor: SimTactile) -> None:
    reading = press_ball(sensor, world, 0.008, 0.009)
    assert reading["indentation"].max() == pytest.approx(DIGIT.max_indentation, rel=0.01)


def test_a_cylinder_leaves_a_line_and_a_box_edge_a_thinner_one() -> None:
    def width(shape: mujoco.mjtGeom, size: Sequence[float], reach: float, turn: NDArray[np.float64]) -> float:
        world = World(model_with(shape, size))
        sensor = SimTactile(world, TOUCH, indentation="geometry")
        put(world, [TIP - 0.0005 + reach, 0.0, MIDDLE], turn)
        felt = sensor.read()["indentation"] > 1e-4
        rows, columns = felt.any(axis=1).sum(), felt.any(axis=0).sum()
        assert columns > 1.3 * rows
        return float(rows)

    edge = np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, math.sqrt(2.0)]]) / math.sqrt(2.0)
    cylinder = width(mujoco.mjtGeom.mjGEOM_CYLINDER, [0.005, 0.02], 0.005, np.eye(3))
    box = width(mujoco.mjtGeom.mjGEOM_BOX, [0.005, 0.005, 0.02], 0.005 * math.sqrt(2.0), edge)
    assert box < cylinder


@pytest.mark.parametrize("force", [5.0, 20.0, 80.0])
def test_the_indentation_grows_with_the_force(force: float) -> None:
    world = ball_world(0.01)
    sensor = SimTactile(world, TOUCH)
    body = world.model.body("object").id
    put(world, [TIP + 0.01, 0.0, MIDDLE])
    assert world.data is not None
    out_of_the_gel = world.data.body(TOUCH.body_name).xmat.reshape(3, 3)[:, 0]
    world.data.xfrc_applied[body, :3] = -force * out_of_the_gel
    for _ in range(30):
        world.advance()
    assert float(sensor.force) == pytest.approx(force, rel=0.02)
    expected = DIGIT.max_indentation * force / DIGIT.force_range[1]
    reading = sensor.read()
    assert reading["indentation"].max() == pytest.approx(expected, rel=0.03)
    given = sensor.force
    world.refresh()  # the state is the same, and no step has led to it
    assert not sensor.read()["indentation"].any()
    np.testing.assert_array_equal(sensor.read(given)["rgb"], reading["rgb"])


def test_every_copy_feels_what_a_world_of_one_feels() -> None:
    model = model_with(mujoco.mjtGeom.mjGEOM_SPHERE, [0.008])
    batch = World(model, copies=3, threads=2)
    sensors = SimTactile(batch, TOUCH, indentation="geometry")
    depths = [0.0005, -0.001, 0.0015]
    for copy, depth in enumerate(depths):
        put(batch, [TIP - depth + 0.008, 0.0, MIDDLE], copy=copy)
    frames = sensors.read()
    assert frames["rgb"].shape == (3, 240, 320, 3)
    for copy, depth in enumerate(depths):
        single = World(model)
        one = press_ball(SimTactile(single, TOUCH, indentation="geometry"), single, 0.008, depth)
        np.testing.assert_array_equal(frames["rgb"][copy], one["rgb"])
        np.testing.assert_array_equal(frames["indentation"][copy], one["indentation"])


def test_a_copy_with_a_larger_ball_feels_it() -> None:
    batch = ball_world(0.006, copies=2, threads=1)
    sensors = SimTactile(batch, TOUCH, indentation="geometry")
    geom = batch.model.geom("object").id
    sizes, radii, boxes = batch.vary("geom_size"), batch.vary("geom_rbound"), batch.vary("geom_aabb")
    sizes[1, geom, 0] = radii[1, geom] = boxes[1, geom, 3:] = 0.012
    put(batch, [TIP - 0.001 + 0.006, 0.0, MIDDLE], copy=0)
    put(batch, [TIP - 0.001 + 0.012, 0.0, MIDDLE], copy=1)
    indentation = sensors.read()["indentation"]
    small, large = (int((felt > 5e-5).sum()) for felt in indentation)
    assert large > 1.2 * small
    np.testing.assert_allclose(indentation.max(axis=(1, 2)), 0.001, rtol=0.03)


def test_what_the_sensor_is_fixed_to_does_not_hide_what_touches() -> None:
    frames: list[NDArray[np.uint8]] = []
    for has_plate in (False, True):
        scene = Scene.empty()
        carrier = scene.spec.worldbody.add_body(name="carrier", pos=[0.0, 0.0, 0.5], gravcomp=1.0)
        carrier.add_joint(name="carrier", type=mujoco.mjtJoint.mjJNT_SLIDE)
        carrier.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.005, 0.0, 0.0], pos=[-0.05, 0.0, 0.0], mass=1.0)
        if has_plate:  # inside of the housing, right before the camera, as the bar of a finger may be
            carrier.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.002, 0.02, 0.02], pos=[0.01, 0.0, MIDDLE], group=3, mass=0.0
            )
        touch = replace(TOUCH, parent_body="carrier", sensor_in_parent=Mount())
        scene.add_tactile(touch)
        scene.spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.008, 0.0, 0.0], pos=[TIP + 0.007, 0.0, 0.5 + MIDDLE]
        )
        frames.append(SimTactile(World(scene.compile()), touch, indentation="geometry").read()["rgb"])
    assert (frames[0] != frames[0][:1]).any()
    np.testing.assert_array_equal(frames[0], frames[1])


def test_a_ball_that_grows_is_felt_as_it_is(world: World, sensor: SimTactile) -> None:
    small = press_ball(sensor, world, 0.008, 0.0005)["indentation"]
    geom = world.model.geom("object").id
    world.model.geom_size[geom, 0] = world.model.geom_rbound[geom] = world.model.geom_aabb[geom, 3:] = 0.0085
    large = sensor.read()["indentation"]
    assert large.max() == pytest.approx(float(small.max()) + 0.0005, abs=1e-5)


def test_reading_changes_no_state(world: World, sensor: SimTactile) -> None:
    put(world, [TIP + 0.007, 0.0, MIDDLE])
    before = world.core.get_state(0)
    sensor.read()
    np.testing.assert_array_equal(world.core.get_state(0), before)


def test_a_frame_is_ready_in_time_for_the_sensors_rate(world: World, sensor: SimTactile) -> None:
    press_ball(sensor, world, 0.008, 0.0015)
    times: list[float] = []
    for _ in range(10):
        start = time.process_time()
        sensor.read()
        times.append(time.process_time() - start)
    assert min(times) < 1.0 / DIGIT.rate


def test_a_sensor_that_is_not_in_the_scene_is_refused(cart: mujoco.MjModel) -> None:
    with pytest.raises(InvalidSetup, match="not in this model"):
        SimTactile(World(cart), TOUCH)


def test_an_option_that_does_not_exist_is_refused(world: World) -> None:
    with pytest.raises(InvalidSetup, match=r"valid: .*'force', 'geometry'"):
        SimTactile(world, TOUCH, indentation="magic")  # pyright: ignore[reportArgumentType]
