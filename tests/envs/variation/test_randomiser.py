"""Randomised episodes depend on seed and episode alone, and every range does what it says."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

import rcs
from rcs._core import Renderer
from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.variation.randomiser import Randomiser
from rcs.sim import Scene, World
from rcs.sim.model_rows import ObjectParts
from rcs.sim.randomisation import Randomisation
from rcs.tasks.pick_cuboid import SIZE

PHYSICS = (
    "object_size", "object_mass", "friction", "object_friction", "joint_damping", "camera_translation",
    "camera_rotation", "servo_stiffness", "servo_damping", "robot_start", "action_latency", "table_height",
)  # fmt: skip
LOOKS = (
    "light_intensity",
    "light_direction",
    "table_colour",
    "object_colour",
    "room_colour",
    "textures",
    "camera_translation",
    "camera_rotation",
    "field_of_view",
    "object_size",
)
OF_STATE_AND_TIME = ("robot_start", "gripper_opening", "late_actions", "frame_latency", "frame_jitter", "distractors")
"""Fields that change no model."""
EVERYTHING = {name: getattr(Randomisation(), name) for name in Randomisation.names()}
STEP = {"joints": np.full(7, 0.01), "gripper": np.zeros(1, np.float32)}


def make(ranges: Randomisation | None, **options: Any) -> Any:
    return rcs.make("PickCuboid", randomisation=ranges, **options)


def fields_of(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Return a copy of every array of a model."""
    arrays = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {name: value.copy() for name, value in arrays.items() if isinstance(value, np.ndarray)}


def changed(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> set[str]:
    return {name for name in one if not np.array_equal(one[name], other[name])}


def states_after(env: Any, seed: int, steps: int = 20) -> np.ndarray:
    env.reset(seed=seed)
    states = [env.simulation.world.states().copy()]
    for _ in range(steps):
        env.step(STEP)
        states.append(env.simulation.world.states().copy())
    return np.array(states)


def frames_of(env: Any, seed: int) -> dict[str, np.ndarray]:
    observation, _ = env.reset(seed=seed)
    return {name: frame["rgb"] for name, frame in observation["frames"].items()}


def flat(drawn: dict[str, np.ndarray], copy: Any = ...) -> np.ndarray:
    return np.concatenate([np.ravel(values[copy]) for key, values in drawn.items() if not key.startswith("_")])


def test_the_same_seed_draws_the_same_in_every_episode_and_another_seed_something_else() -> None:
    first, second = make(Randomisation()), make(Randomisation())
    for seed in (5, None, None, 6, 5):
        _, one = first.reset(seed=seed)
        _, two = second.reset(seed=seed)
        np.testing.assert_array_equal(flat(one["randomisation"]), flat(two["randomisation"]))
        assert changed(fields_of(first.simulation.world.model), fields_of(second.simulation.world.model)) == set()
    episodes = [flat(first.reset(seed=seed)[1]["randomisation"]) for seed in (5, None, 6, 7)]
    assert len({drawn.tobytes() for drawn in episodes}) == 4


def test_an_episode_owes_nothing_to_the_one_before() -> None:
    fresh, used = make(Randomisation()), make(Randomisation())
    for seed in range(5):
        used.reset(seed=seed)
    np.testing.assert_array_equal(states_after(fresh, 9), states_after(used, 9))


def test_a_copy_is_bit_for_bit_the_single_environment_with_its_seed() -> None:
    envs = rcs.make_vec("PickCuboid", copies=3, threads=2, randomisation=True, autoreset="Disabled")
    _, info = envs.reset(seed=20)
    steps = {"joints": np.tile(STEP["joints"], (3, 1)), "gripper": np.zeros((3, 1), np.float32)}
    states = [envs.simulation.world.states().copy()]
    for _ in range(20):
        envs.step(steps)
        states.append(envs.simulation.world.states().copy())
    for copy in range(3):
        single = make(Randomisation())
        np.testing.assert_array_equal(states_after(single, 20 + copy), np.array(states)[:, copy])
        np.testing.assert_array_equal(flat(single.simulation.randomisation), flat(info["randomisation"], copy))


def test_copies_that_start_anew_leave_the_others_as_they_are() -> None:
    envs = rcs.make_vec("PickCuboid", copies=3, randomisation=True, autoreset="Disabled")
    _, info = envs.reset(seed=0)
    before, masses = info["randomisation"], envs.simulation.world.field("body_mass").copy()
    kept = {key: values.copy() for key, values in before.items()}
    _, info = envs.reset(options={"reset_mask": np.array([True, False, True])})
    after = info["randomisation"]
    single = make(Randomisation())
    single.reset(seed=0)
    single.reset()
    np.testing.assert_array_equal(flat(after, 1), flat(before, 1))
    np.testing.assert_array_equal(flat(after, 0), flat(single.simulation.randomisation))
    np.testing.assert_array_equal(envs.simulation.world.field("body_mass")[0], single.simulation.world.model.body_mass)
    np.testing.assert_array_equal(envs.simulation.world.field("body_mass")[1], masses[1])
    for key, values in kept.items():  # what was told of an episode stays what it was
        np.testing.assert_array_equal(before[key], values)


@pytest.mark.parametrize("autoreset", ["NextStep", "SameStep"])
def test_a_step_tells_what_was_drawn_for_the_episodes_that_start_in_it(autoreset: str) -> None:
    options: dict[str, Any] = {"randomisation": True, "max_episode_steps": 3, "autoreset": autoreset}
    envs = rcs.make_vec("PickCuboid", copies=2, **options)
    _, info = envs.reset(seed=0)
    first = info["randomisation"]["object_mass"]
    starts = []
    for _ in range(5):
        *_, info = envs.step({"joints": np.zeros((2, 7)), "gripper": np.zeros((2, 1), np.float32)})
        if info.get("_randomisation", np.zeros(2, bool)).all():
            starts.append(info["randomisation"]["object_mass"])
            assert info["randomisation"]["_object_mass"].all()
    assert len(starts) == 1
    assert (starts[0] != first).all()
    np.testing.assert_array_equal(starts[0], envs.simulation.randomisation["object_mass"])


def test_ranges_of_no_width_change_nothing() -> None:
    plain, off = make(None), make(Randomisation.off())
    np.testing.assert_array_equal(states_after(plain, 3), states_after(off, 3))
    assert changed(fields_of(plain.simulation.world.model), fields_of(off.simulation.world.model)) == set()
    envs = rcs.make_vec("PickCuboid", copies=2, randomisation=Randomisation.off())
    _, info = envs.reset(seed=3)
    assert not envs.simulation.world.core.is_varied
    assert info["randomisation"] == {}


def test_the_task_starts_alike_with_and_without() -> None:
    _, plain = make(None).reset(seed=4)
    _, varied = make(Randomisation()).reset(seed=4)
    for i in (0, 1, 5, 6):
        assert plain["cuboid"][i] == varied["cuboid"][i]


@pytest.mark.parametrize("field", [field for field in EVERYTHING if field not in OF_STATE_AND_TIME])
def test_each_range_changes_the_model_and_draws_from_a_stream_of_its_own(field: str) -> None:
    alone = make(
        Randomisation.off(**{field: EVERYTHING[field]}), cameras=rcs.Cameras(names=("wrist", "side"), image_size=8)
    )
    every = make(Randomisation(), cameras=rcs.Cameras(names=("wrist", "side"), image_size=8))
    nominal = fields_of(alone.simulation.world.model)
    alone.simulation.begin(EpisodeRandom(1, 0))
    every.simulation.begin(EpisodeRandom(1, 0))
    assert list(alone.simulation.randomisation) == [field]
    np.testing.assert_array_equal(alone.simulation.randomisation[field], every.simulation.randomisation[field])
    assert changed(fields_of(alone.simulation.world.model), nominal)


@pytest.mark.parametrize("field", PHYSICS)
def test_each_physical_range_changes_the_motion(field: str) -> None:
    plain = make(None, cameras=rcs.Cameras(names=("wrist",), image_size=8))
    varied = make(Randomisation.off(**{field: EVERYTHING[field]}), cameras=rcs.Cameras(names=("wrist",), image_size=8))
    drop, push = [], []
    for env in (plain, varied):
        env.reset(seed=1)
        world = env.simulation.world
        first = int(world.model.joint("cuboid").qposadr[0])
        world.qpos[first + 2] += 0.01
        world.qvel[-6:] = [0.5, 0.0, 0.0, 0.0, 1.0, 0.0]
        robot = env.simulation.robots[0]
        start = robot.joints
        for i in range(10):
            robot.command_joints(start + 0.01 * (i + 1))
            world.core.advance()
        drop.append(world.qpos[first:].copy())
        push.append(world.qpos[:first].copy())
    assert not (np.array_equal(*drop) and np.array_equal(*push))


@pytest.mark.gl
@pytest.mark.parametrize("field", LOOKS)
def test_each_visible_range_changes_the_picture(field: str) -> None:
    ranges = Randomisation.off(**{field: EVERYTHING[field]})
    plain, varied = (make(given, cameras=rcs.Cameras(names=("side",), image_size=96)) for given in (None, ranges))
    before = frames_of(plain, 2)["side"].astype(int)
    after = frames_of(varied, 2)["side"].astype(int)
    assert np.abs(before - after).max() > 3
    for env in (plain, varied):
        env.close()


@pytest.mark.gl
def test_ranges_of_no_width_draw_the_same_picture() -> None:
    plain, off = (
        make(given, cameras=rcs.Cameras(names=("side",), image_size=64)) for given in (None, Randomisation.off())
    )
    np.testing.assert_array_equal(frames_of(plain, 2)["side"], frames_of(off, 2)["side"])
    plain.close()
    off.close()


@pytest.mark.gl
def test_every_copy_is_drawn_as_its_single_environment_and_unlike_the_others() -> None:
    options: dict[str, Any] = {"randomisation": True, "cameras": rcs.Cameras(names=("wrist", "side"), image_size=64)}
    envs = rcs.make_vec("PickCuboid", copies=6, threads=3, **options)
    single = rcs.make("PickCuboid", **options)
    observation, _ = envs.reset(seed=7)
    for name in ("wrist", "side"):
        frames = observation["frames"][name]["rgb"]
        assert len({frame.tobytes() for frame in frames}) == 6
        for copy in range(6):
            np.testing.assert_array_equal(frames_of(single, 7 + copy)[name], frames[copy])
    envs.close()
    single.close()


@pytest.mark.gl
def test_the_position_of_a_light_that_is_near_changes_the_picture() -> None:
    scene = Scene.empty()
    scene.add_table()
    scene.spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_SPOT, pos=[0.4, 0, 0.8], cutoff=80)
    scene.spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.2, 0, 0], pos=[0.4, 0, 0.2])
    model = scene.compile()
    renderer = Renderer(model, max_width=64, max_height=64)
    pictures = np.empty((2, 64, 64, 3), np.uint8)
    world = World(model)
    randomiser = Randomiser(world, Randomisation.off(light_position=0.2))
    for i in range(2):
        mujoco.mj_forward(model, world.data)
        renderer.update(world.data)
        renderer.render(model.camera("overview").id, pictures[i])
        randomiser.begin(EpisodeRandom(0, 0))
    renderer.close()
    assert np.abs(pictures[0].astype(int) - pictures[1]).max() > 3


def test_draws_fill_their_ranges_evenly() -> None:
    envs = rcs.make_vec("PickCuboid", copies=400, threads=1, randomisation=True)
    _, info = envs.reset(seed=0)
    for field in ("object_mass", "object_size", "friction", "light_intensity", "joint_damping"):
        low, high = EVERYTHING[field]
        drawn = info["randomisation"][field]
        assert ((drawn >= low) & (drawn <= high)).all()
        assert drawn.min() < low + 0.05 * (high - low)
        assert drawn.max() > high - 0.05 * (high - low)
    counts = np.bincount(info["randomisation"]["textures"].ravel().astype(int), minlength=5)
    assert counts.min() > 50
    assert len(counts) == 5


def test_masses_and_inertias_are_those_of_the_scaled_object() -> None:
    env = make(Randomisation.off(object_size=(1.3, 1.3), object_mass=(2.0, 2.0)))
    model = env.simulation.world.model
    nominal = fields_of(model)
    env.reset(seed=0)
    body, geom = model.body("cuboid").id, model.geom("cuboid").id
    edges = 1.3 * np.array(SIZE)
    mass = 2.0 * nominal["body_mass"][body]
    assert model.body_mass[body] == pytest.approx(mass)
    np.testing.assert_allclose(2 * model.geom_size[geom], edges)
    x, y, z = edges**2
    inertia = mass / 12 * np.array([y + z, x + z, x + y])
    np.testing.assert_allclose(np.sort(model.body_inertia[body]), np.sort(inertia))
    np.testing.assert_allclose(model.geom_rbound[geom], np.linalg.norm(edges) / 2)
    np.testing.assert_allclose(model.geom_aabb[geom], [0, 0, 0, *edges / 2])
    # The robot's own figures are untouched.
    others = np.arange(model.nbody) != body
    np.testing.assert_array_equal(model.body_mass[others], nominal["body_mass"][others])


def test_a_larger_object_is_touched_where_its_surface_is() -> None:
    """The bounding volumes grow along: a ball that just reaches the larger cuboid is found."""
    for scale, touches in ((1.0, False), (1.5, True)):
        scene = Scene.empty()
        body = scene.spec.worldbody.add_body(name="box", pos=[0, 0, 1])
        body.add_freejoint()
        for x in (-0.05, 0.05):  # two geoms: a body with one has no tree of bounding volumes to be wrong
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.05, 0.05, 0.05], pos=[x, 0, 0], mass=0.1)
        ball = scene.spec.worldbody.add_body(name="ball", pos=[0.16, 0, 1])
        ball.add_freejoint()
        for y in (0.0, 0.03):
            ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], pos=[0, y, 0], mass=0.1)
        world = World(scene.compile())
        Randomiser(world, Randomisation.off(object_size=(scale, scale)), objects=["box"]).begin(EpisodeRandom(0, 0))
        mujoco.mj_forward(world.model, world.data)
        assert bool(world.data.ncon) == touches


def test_the_task_knows_how_large_its_cuboid_is() -> None:
    for copies in (None, 3):
        ranges = Randomisation.off(object_size=(0.8, 1.2))
        env = (
            make(ranges)
            if copies is None
            else rcs.make_vec("PickCuboid", copies=copies, randomisation=ranges, autoreset="Disabled")
        )
        _, info = env.reset(seed=1)
        factor = info["randomisation"]["object_size"][..., 0]
        np.testing.assert_allclose(info["cuboid"][..., 2], factor * SIZE[2] / 2, rtol=1e-12)
        action = {key: np.zeros((*np.shape(factor), *value.shape), value.dtype) for key, value in STEP.items()}
        for _ in range(30):
            *_, info = env.step(action)
        np.testing.assert_allclose(info["cuboid"][..., 2], factor * SIZE[2] / 2, atol=1e-4)


def test_cameras_move_by_what_was_drawn() -> None:
    env = make(
        Randomisation.off(camera_translation=0.05, camera_rotation=0.1),
        cameras=rcs.Cameras(names=("side",), image_size=8),
    )
    world = env.simulation.world

    def pose() -> tuple[np.ndarray, np.ndarray]:
        mujoco.mj_kinematics(world.model, world.data)
        body = world.data.body("side/camera")
        return body.xpos.copy(), body.xmat.reshape(3, 3).copy()

    position, axes = pose()
    _, info = env.reset(seed=0)
    moved, turned = pose()
    np.testing.assert_allclose(axes.T @ (moved - position), info["randomisation"]["camera_translation"][0], atol=1e-9)
    turn = axes.T @ turned
    vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    np.testing.assert_allclose(vector, info["randomisation"]["camera_rotation"][0], atol=1e-3)


def test_only_what_is_rigid_and_of_simple_shapes_changes_its_size() -> None:
    spec = Scene.empty().spec
    mesh = spec.add_mesh(name="mesh")
    mesh.make_hemisphere(4)
    box = spec.worldbody.add_body(name="box")
    box.add_freejoint()
    box.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.1])
    tin = spec.worldbody.add_body(name="tin", pos=[1, 0, 0])
    tin.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.1])
    lid = tin.add_body(name="lid", pos=[0, 0, 0.2])
    lid.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE)
    lid.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.1])
    bowl = spec.worldbody.add_body(name="bowl", pos=[2, 0, 0])
    bowl.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
    world = World(spec.compile())
    scalable = {name: ObjectParts(world, name).is_scalable for name in ("box", "tin", "bowl")}
    assert scalable == {"box": True, "tin": False, "bowl": False}
    randomiser = Randomiser(world, Randomisation.off(object_size=(2, 2), object_mass=(3, 3)), objects=list(scalable))
    before = fields_of(world.model)
    randomiser.begin(EpisodeRandom(0, 0))
    assert randomiser.names["object_size"] == ("box",)
    np.testing.assert_allclose(world.model.body_mass[1:], 3 * before["body_mass"][1:])
    np.testing.assert_allclose(world.model.body_inertia[2:], 3 * before["body_inertia"][2:])
    np.testing.assert_allclose(world.model.body_inertia[1], 12 * before["body_inertia"][1])


def test_a_scene_with_nothing_to_vary_is_left_alone() -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0, 0])
    world = World(spec.compile())
    before = fields_of(world.model)
    randomiser = Randomiser(world, Randomisation())
    randomiser.begin(EpisodeRandom(0, 0))
    assert list(randomiser.values) == ["friction"]
    assert changed(before, fields_of(world.model)) == {"geom_friction"}
