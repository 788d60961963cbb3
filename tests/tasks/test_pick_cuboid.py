from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.episode_random import EpisodeRandom
from rcs.errors import InvalidSetup
from rcs.robots.description import Mount
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.sim import RobotPlacement, Scene, World
from rcs.sim.robot import SimRobot
from rcs.spatial import Pose
from rcs.tasks.holding import SLIP
from rcs.tasks.pick_cuboid import SIZE, PickCuboid

OPTIONS = PickCuboid.Options()
DOWN = Pose.from_rpy([0.0, 0.0, 0.0], [np.pi, 0.0, 0.0])


def carry(env: Any, height: float) -> np.ndarray:
    """Put the cuboid between the fingers at home and take it to a height; return its qpos address."""
    world = env.simulation.world
    first = int(world.model.joint("cuboid").qposadr[0])
    world.qpos[first : first + 3] = world.poses[0, :3] + [0.0, 0.0, height - world.poses[0, 2]]
    world.qpos[first + 3 : first + 7] = [1.0, 0.0, 0.0, 0.0]
    return first


def test_the_cuboid_has_the_size_and_mass_of_the_papers() -> None:
    model = rcs.make("PickCuboid").simulation.world.model
    np.testing.assert_allclose(2 * model.geom("cuboid").size, SIZE)
    assert SIZE == (0.064, 0.032, 0.0576)
    assert model.body("cuboid").mass[0] == pytest.approx(0.05)


def test_the_cuboid_lies_anywhere_in_the_area_at_any_yaw() -> None:
    envs = rcs.make_vec("PickCuboid", copies=200, threads=1)
    _, info = envs.reset(seed=0)
    cuboid = info["cuboid"]
    area = envs.simulation.task.area
    low = np.array(area.center) - np.array(area.size) / 2
    high = np.array(area.center) + np.array(area.size) / 2
    places = cuboid[:, :2]
    assert ((places >= low) & (places <= high)).all()
    assert (places.min(axis=0) < low + 0.05 * np.array(area.size)).all()
    assert (places.max(axis=0) > high - 0.05 * np.array(area.size)).all()
    np.testing.assert_allclose(cuboid[:, 2], SIZE[2] / 2, atol=1e-9)
    yaw = np.array([Pose(pose[:3], pose[3:]).rpy[2] for pose in cuboid])
    assert yaw.min() < -2.8
    assert yaw.max() > 2.8
    np.testing.assert_allclose(cuboid[:, 3:5], 0.0, atol=1e-9)


def test_an_untouched_cuboid_stays_where_it_lies() -> None:
    env = rcs.make("PickCuboid")
    _, info = env.reset(seed=2)
    for _ in range(30):
        *_, after = env.step({"joints": np.zeros(7), "gripper": np.ones(1, np.float32)})
    np.testing.assert_allclose(after["cuboid"], info["cuboid"], atol=1e-4)
    assert not any(after[key] for key in ("is_grasped", "is_touched", "success"))


def test_a_cuboid_that_is_only_high_is_not_a_success() -> None:
    env = rcs.make("PickCuboid", reward="dense")
    env.reset(seed=0)
    first = carry(env, 0.5)
    world = env.simulation.world
    for _ in range(int(2 * OPTIONS.hold_time * 30)):
        world.qpos[first + 2] = 0.5
        world.qvel[-6:] = 0.0
        _, reward, terminated, _, info = env.step({"joints": np.zeros(7), "gripper": np.ones(1, np.float32)})
        assert not terminated
        assert not info["is_grasped"]
        assert reward <= 1 / 5
        assert not info["success"]


def test_a_cuboid_that_is_grasped_high_for_the_hold_time_is_a_success_and_not_before() -> None:
    env = rcs.make("PickCuboid", reward="sparse")
    env.reset(seed=0)
    world = env.simulation.world
    tcp = world.poses[0].copy()
    first = carry(env, tcp[2])
    # The fingers open along y, across which the cuboid is 32 mm wide.
    rewards, ends = [], []
    since, height = None, 0.0
    for step in range(60):
        if step < 20:  # until the fingers have closed on it, it is kept in its place
            world.qpos[first : first + 3] = tcp[:3]
            world.qpos[first + 3 : first + 7] = [1.0, 0.0, 0.0, 0.0]
            world.qvel[-6:] = 0.0
        _, reward, terminated, _, info = env.step({"joints": np.zeros(7), "gripper": np.zeros(1, np.float32)})
        rewards.append(float(reward))
        ends.append(terminated)
        is_held = info["is_grasped"] and info["cuboid"][2] - SIZE[2] / 2 > OPTIONS.lift_height
        if not is_held or since is None or abs(info["cuboid"][2] - height) > SLIP:
            since, height = (info["time"], info["cuboid"][2]) if is_held else (None, 0.0)
        assert terminated == (since is not None and info["time"] - since > OPTIONS.hold_time - 1e-3)
        if terminated:
            break
    assert ends[-1]
    assert rewards[-1] == 1.0
    assert not any(rewards[:-1])
    assert info["success"]


def test_the_reward_is_positive_on_the_way_to_the_cuboid_and_staying_there_costs() -> None:
    env = rcs.make("PickCuboid", control="tquat", relative=False, discount=0.98)
    _, info = env.reset(seed=1)
    target = info["cuboid"].copy()
    rewards = []
    for height in [*np.linspace(0.25, 0.05, 30), *[0.05] * 60]:
        pose = np.concatenate([target[:2], [height], DOWN.quaternion])
        _, reward, *_ = env.step({"tquat": pose, "gripper": np.ones(1, np.float32)})
        rewards.append(reward)
    # The first steps lead from home to above the cuboid, within the arm's limits.
    assert min(rewards[10:30]) > 0.0
    np.testing.assert_allclose(rewards[-20:], (0.98 - 1.0) / 3, atol=2e-3)


def test_a_new_episode_forgets_how_long_the_cuboid_was_held() -> None:
    envs = rcs.make_vec("PickCuboid", copies=3, autoreset="Disabled")
    envs.reset(seed=0)
    held, world, yes = envs.simulation.task._held, envs.simulation.world, np.ones(3, np.bool_)
    held.count(yes)
    world.time[:] = 2.0
    held.reset(np.array([0, 2]))
    np.testing.assert_array_equal(held.count(yes), [False, True, False])
    held.reset(...)
    np.testing.assert_array_equal(held.count(yes), [False, False, False])


@pytest.mark.parametrize(
    ("robots", "text"),
    [
        ([], "one robot"),
        ([RobotPlacement(name="fr3", arm=FR3)], "with a gripper"),
    ],
)
def test_a_scene_that_the_task_cannot_use_is_refused(robots: list[RobotPlacement], text: str) -> None:
    task = PickCuboid(rcs.make("PickCuboid").simulation.task.area)
    scene = Scene.empty()
    task.furnish(scene)
    for robot in robots:
        scene.add_robot(robot)
    world = World(scene.compile())
    with pytest.raises(InvalidSetup, match=text):
        task.bind(world, [SimRobot(world, robot) for robot in robots])


def test_the_cuboid_lies_in_the_scene_and_is_told_in_the_base_frame() -> None:
    task = PickCuboid(rcs.make("PickCuboid").simulation.task.area)
    scene = Scene.empty()
    task.furnish(scene)
    turned = Mount(translation=(-0.1, 0.2, 0.05), quaternion=(0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)))
    scene.add_robot(RobotPlacement(name="fr3", arm=FR3, gripper=FRANKA_HAND, base_in_scene=turned))
    world = World(scene.compile())
    task.bind(world, [SimRobot(world, scene.robots[0])])
    task.reset(EpisodeRandom(0, 0), ...)
    world.refresh()
    in_base = Pose.from_tquat(task.describe()["cuboid"])
    in_scene = Pose(turned.translation, turned.quaternion) * in_base
    expected = Pose.from_tquat(rcs.make("PickCuboid").reset(seed=0)[1]["cuboid"])
    assert in_scene.is_close(expected, 1e-9, 1e-9)


@pytest.mark.parametrize(
    ("option", "value"), [("pose", "flat"), ("edges", "random"), ("distractors", 1), ("obstacles", 2)]
)
def test_a_robot_places_the_usual_cuboid_alone(option: str, value: Any) -> None:
    with pytest.raises(InvalidSetup, match=f"placed_by is 'robot' and {option}"):
        rcs.make("PickCuboid", task_options={"placed_by": "robot", option: value})
