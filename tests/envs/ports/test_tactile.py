from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.agents import agent_for
from rcs.envs.ports.simulated import SimArmPort, SimCameraPort, SimTactilePort
from rcs.envs.step.chain import Chain
from rcs.envs.step.clock import Clock
from rcs.envs.step.stack import Stack
from rcs.errors import InvalidSetup
from rcs.robots.cameras import REALSENSE_D435
from rcs.robots.description import Mount
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.robots.tactile import DIGIT
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.replay import replay
from rcs.sim import CameraPlacement, RobotPlacement, Scene, World
from rcs.sim.camera import SimCameras
from rcs.sim.camera_feed import FrameClock, FrameRate
from rcs.sim.robot import SimRobot
from rcs.sim.tactile import SimTactile
from rcs.sim.tactile_mounts import on_pads

ROBOT = RobotPlacement(name="fr3", arm=FR3, gripper=FRANKA_HAND)
EYE = CameraPlacement(
    name="eye",
    camera=REALSENSE_D435,
    parent_body="world",
    optical_in_parent=Mount(translation=(0.3, 0.0, 1.0), quaternion=(1.0, 0.0, 0.0, 0.0)),
)


def scene() -> Scene:
    scene = Scene.empty()
    scene.add_robot(ROBOT)
    scene.add_camera(EYE)
    for sensor in on_pads(ROBOT, DIGIT):
        scene.add_tactile(sensor)
    return scene


@pytest.mark.parametrize("copies", [None, 2])
def test_frames_of_the_sensors_are_in_the_observation(copies: int | None) -> None:
    scene_ = scene()
    world = World(scene_.compile(), copies=copies, threads=1)
    robot = SimRobot(world, ROBOT)
    sensors = [SimTactile(world, placement) for placement in scene_.tactile]
    stack = Stack(Chain([SimArmPort(robot), SimTactilePort(sensors)], [], world.leading))
    robot.go_home()
    world.refresh()
    Clock(world).advance()
    observation = stack.lift(stack.measure())
    assert set(observation["frames"]) == {"fr3_left", "fr3_right"}
    if copies is None:
        assert stack.observation_space.contains(observation)
    for name in ("fr3_left", "fr3_right"):
        assert observation["frames"][name]["rgb"].shape == (*world.leading, 240, 320, 3)
        assert f"frames/{name}" in stack.capture_times()
    stack.close()


@pytest.mark.gl
def test_frames_of_sensors_and_cameras_stand_next_to_each_other() -> None:
    scene_ = scene()
    world = World(scene_.compile())
    sensors = [SimTactile(world, placement) for placement in scene_.tactile]
    stack = Stack(
        Chain(
            [
                SimTactilePort(sensors),
                SimCameraPort(
                    SimCameras(world, [EYE], size=(32, 24)), FrameClock(world, {EYE.name: FrameRate(fps=30)})
                ),
            ]
        )
    )
    world.refresh()
    frames = stack.measure()[""]["frames"]
    assert set(frames) == {"eye", "fr3_left", "fr3_right"}
    assert stack.observation_space["frames"].contains(frames)
    assert set(stack.capture_times()) == {"frames/eye", "frames/fr3_left", "frames/fr3_right"} == set(stack.timed)
    assert frames["eye"]["rgb"].dtype == np.uint8
    stack.close()
    stack.close()


def test_two_of_one_name_are_refused() -> None:
    scene_ = scene()
    world = World(scene_.compile())
    ports = [SimTactilePort([SimTactile(world, scene_.tactile[0])]) for _ in range(2)]
    with pytest.raises(InvalidSetup, match="frames/fr3_left/rgb"):
        Chain(ports)


def test_a_setup_with_digits_on_its_pads_is_collected_and_replayed(tmp_path: Path) -> None:
    setup = rcs.Setup(tactile="digit")
    for _ in collect(Collection(setup=setup, out=tmp_path / "digit", episodes=1, seed=1), Progress()):
        pass
    episode = Dataset.open(tmp_path / "digit").episodes[0]
    assert episode.success
    frames = list(episode.frames("observation/frames/fr3_left/rgb"))
    assert frames[0].shape == (240, 320, 3)
    change = np.abs(frames[-1].astype(int) - frames[0]).max()
    assert change > 20, "it feels the cuboid in the end and nothing at the beginning"
    assert all(result.is_equal for result in replay(tmp_path / "digit"))


@pytest.mark.parametrize("robot", ["ur5e", "so101"])
def test_the_expert_grasps_with_digits_on_any_gripper_and_both_feel_it(robot: str) -> None:
    setup = rcs.Setup(task="PickCuboid", robot=robot, tactile="digit")
    env = rcs.make(setup)
    expert = agent_for(env)
    observation, info = env.reset(seed=3)
    expert.reset(observation, info)
    names = [f"{robot}_left", f"{robot}_right"]
    open_frames = {name: observation["frames"][name]["rgb"] for name in names}
    is_over = False
    while not is_over:
        observation, _, terminated, truncated, info = env.step(expert.act(observation, info))
        is_over = terminated or truncated
        if not info["is_touched"]:
            for name in names:
                np.testing.assert_array_equal(observation["frames"][name]["rgb"], open_frames[name])
    assert info["success"]
    for name in names:
        change = np.abs(observation["frames"][name]["rgb"].astype(int) - open_frames[name])
        assert change.max() > 15
        assert (change.max(axis=2) > 0).mean() > 0.2
    env.close()


@pytest.mark.parametrize("end_effector", ["tilburg_hand", "none"])
def test_what_has_no_pads_is_refused_with_what_has_them(end_effector: str) -> None:
    with pytest.raises(InvalidSetup, match=r"has no pads for DIGIT.*franka_hand, robotiq_2f85, so101_gripper have"):
        rcs.make("Free", robot="ur5e", end_effector=end_effector, tactile="digit")
