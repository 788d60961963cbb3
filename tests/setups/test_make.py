from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.errors import InvalidSetup, UnknownName
from rcs.setups.lab import lab_of, looking
from rcs.spatial import Pose


def test_a_setup_makes_what_its_fields_make() -> None:
    setup = rcs.Setup(task="Free", control="xyzrpy", frequency=50.0)
    one, other = rcs.make(setup), rcs.make("Free", control="xyzrpy", frequency=50.0)
    assert str(one) == str(other)
    a, b = one.reset(seed=1)[0], other.reset(seed=1)[0]
    for key in a:
        np.testing.assert_array_equal(a[key], b[key])
    assert str(rcs.make_vec(setup, copies=2)) == str(rcs.make_vec("Free", copies=2, control="xyzrpy", frequency=50.0))


@pytest.mark.parametrize(
    ("options", "texts"),
    [
        ({"task": "PickCubiod"}, ["task named 'PickCubiod'", "Did you mean 'PickCuboid'?", "Free"]),
        ({"robot": "fr4"}, ["robot named 'fr4'", "Did you mean 'fr3'?"]),
        ({"end_effector": {"fr4": "none"}}, ["robot of this setup named 'fr4'", "Did you mean 'fr3'?"]),
        ({"end_effector": {"fr3": "franka_hnd"}}, ["end effector named 'franka_hnd'"]),
        ({"end_effector": "franka_hnd"}, ["end effector named 'franka_hnd'", "Did you mean 'franka_hand'?"]),
        ({"cameras": ("wirst",)}, ["lab of 'fr3'", "'wirst'", "Did you mean 'wrist'?", "side"]),
        ({"cameras": ("wrist", "top")}, ["'top'", "side, wrist"]),
        (
            {"cameras": rcs.Cameras(names=("side",), mode="848x484")},
            ["mode of realsense_d435", "Did you mean '848x480'?"],
        ),
        ({"cameras": rcs.Cameras(names=("side",), mode="large")}, ["mode of realsense_d435", "320x180, 320x240"]),
        # The D405 has it and the D435 has not.
        ({"cameras": rcs.Cameras(names=("wrist", "side"), mode="480x270")}, ["mode of realsense_d435", "1920x1080"]),
    ],
)
def test_an_unknown_name_gives_the_nearest_match(options: dict[str, Any], texts: list[str]) -> None:
    for make in (rcs.make, rcs.make_vec):
        with pytest.raises(UnknownName) as caught:
            make(**options)
        for text in texts:
            assert text in str(caught.value)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"frequenzy": 30.0}, "frequenzy"),
        ({"control": "velocity"}, "control"),
        ({"copies": 0}, "copies"),
        ({"copies": 2.5}, "copies"),
        ({"threads": -1}, "threads"),
        ({"stepping": "realtime"}, "wall clock"),
    ],
)
def test_an_option_of_a_batch_that_makes_no_sense_is_refused(options: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidSetup, match=text):
        rcs.make_vec("Free", **options)


@pytest.mark.parametrize("make", [rcs.make, rcs.make_vec])
def test_a_frame_rate_that_a_camera_does_not_have_is_refused_with_its_modes(make: Any) -> None:
    with pytest.raises(InvalidSetup, match=r"realsense_d435 does not deliver 90 .* 60 for that size.*848x480 at 6, 15"):
        make("Free", cameras=rcs.Cameras(names=("wrist", "side"), fps=90))
    make("Free", cameras=rcs.Cameras(names=("wrist", "side"), fps={"wrist": 90, "side": 60})).close()


def test_a_setup_and_options_exclude_each_other() -> None:
    with pytest.raises(InvalidSetup, match="replace"):
        rcs.make(rcs.Setup(), frequency=10.0)
    assert rcs.make(dataclasses.replace(rcs.Setup(task="Free"), frequency=10.0)) is not None


def test_a_gripper_that_is_not_binary_stops_in_between() -> None:
    openings = {}
    for is_binary in (True, False):
        env = rcs.make("Free", binary_gripper=is_binary)
        env.reset(seed=0)
        for _ in range(30):
            observation, *_ = env.step({"joints": np.zeros(7), "gripper": np.full(1, 0.6, np.float32)})
        openings[is_binary] = float(observation["gripper"][0])
    assert openings[True] == pytest.approx(1.0, abs=0.02)
    assert openings[False] == pytest.approx(0.6, abs=0.02)


def test_control_steps_last_what_the_frequency_says() -> None:
    env = rcs.make("Free", frequency=20.0, physics_step=0.001)
    env.reset(seed=0)
    for _ in range(5):
        env.step(env.action_space.sample())
    world = env.simulation.world
    assert float(world.time) == pytest.approx(0.25, abs=1e-9)
    assert world.model.opt.timestep == 0.001


def test_a_robot_without_a_lab_is_refused() -> None:
    with pytest.raises(UnknownName, match="fr3"):
        lab_of("fr5")


def test_a_camera_that_looks_at_a_point_has_it_in_the_middle_of_its_picture() -> None:
    eye, target = np.array([0.8, 0.85, 0.5]), np.array([0.45, 0.0, 0.12])
    mount = looking(eye, target)
    optical = Pose(mount.translation, mount.quaternion)
    in_optical = optical.inverse() * Pose(target)
    np.testing.assert_allclose(in_optical.translation, [0.0, 0.0, np.linalg.norm(target - eye)], atol=1e-9)
    above = optical.inverse() * Pose(target + np.array([0.0, 0.0, 0.1]))
    assert above.translation[1] < -0.01  # y is down in a picture
    assert above.translation[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("robot", "end_effector", "text"),
    [("fr3", "so101_gripper", "made for so101"), ("so101", "franka_hand", "carries so101_gripper and nothing else")],
)
def test_combinations_that_do_not_fit_are_refused_with_the_reason(robot: str, end_effector: str, text: str) -> None:
    with pytest.raises(InvalidSetup, match=text):
        rcs.make("Free", robot=robot, end_effector=end_effector)


def test_each_of_two_robots_carries_its_own() -> None:
    with rcs.make("Free", robot="dual_fr3", end_effector={"left": "robotiq_2f85", "right": "none"}) as env:
        assert list(env.platform) == ["left", "right", "left/robotiq_2f85"]
        assert set(env.action_space["left"]) == {"joints", "gripper"}
        assert set(env.action_space["right"]) == {"joints"}
        assert rcs.Setup.from_json(json.loads(json.dumps(env.setup.to_json()))) == env.setup
        env.reset(seed=0)
        env.step(env.action_space.sample())
    with rcs.make("Free", robot="dual_fr3", end_effector={"left": "tilburg_hand"}) as env:
        assert list(env.platform) == ["left", "right", "left/tilburg_hand", "right/franka_hand"]


@pytest.mark.parametrize("robot", ["fr3", "ur5e", "xarm7"])
@pytest.mark.parametrize("end_effector", ["franka_hand", "robotiq_2f85", "tilburg_hand", "none"])
def test_any_end_effector_composes_with_any_arm_that_has_a_flange(robot: str, end_effector: str) -> None:
    env = rcs.make("Free", robot=robot, end_effector=end_effector)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    observation, *_ = env.step(env.action_space.sample())
    assert env.observation_space.contains(observation)


@pytest.mark.parametrize(
    "options",
    [
        {"copies": 0},
        {"copies": 2.0},
        {"copies": None},
        {"copies": True},
        {"threads": None},
        {"threads": -1},
        {"threads": 2**40},
        {"copies": 2**40},
    ],
)
def test_numbers_of_copies_and_threads_that_make_no_sense_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(InvalidSetup, match=next(iter(options))):
        rcs.make_vec("Free", **options)


def test_an_unknown_autoreset_lists_the_valid_ones() -> None:
    with pytest.raises(InvalidSetup, match="NextStep"):
        rcs.make_vec("Free", autoreset="sometimes")


def test_numbers_may_be_those_of_numpy() -> None:
    options: dict[str, Any] = {
        "cameras": rcs.Cameras(image_size=(np.int64(32), np.int32(24))),
        "frequency": np.float32(20),
    }
    setup = rcs.Setup(task="Free", max_episode_steps=np.int64(7), **options)
    assert setup == rcs.Setup(
        task="Free", max_episode_steps=7, cameras=rcs.Cameras(image_size=(32, 24)), frequency=20.0
    )
    assert rcs.Setup.from_json(json.loads(json.dumps(setup.to_json()))) == setup
    assert rcs.make_vec("Free", copies=np.int64(2), threads=np.int64(1)).num_envs == 2
