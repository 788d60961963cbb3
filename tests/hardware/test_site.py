"""A site says which devices are real; what it leaves out is simulated."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.devices.fakes import FakeArm, FakeGripper
from rcs.errors import DeviceFault, InvalidSetup, UnknownName
from rcs.hardware import DeviceAddress, Driver, FakeDriver, Site
from rcs.hardware.fake import limits_of
from rcs.robots.fr3.description import FR3

HOME = np.array(FR3.home)


def home_arm(**options: Any) -> FakeArm:
    return FakeArm(limits_of(FR3), start=HOME, **options)


def test_a_site_is_what_its_file_says(tmp_path: Path) -> None:
    site = Site(
        arms={"fr3": "fake:192.0.2.1"}, cameras={"wrist": {"driver": "fake", "options": {"a": 1}}}, stale_after=1.0
    )
    assert site.arms["fr3"] == DeviceAddress(driver="fake", address="192.0.2.1")
    site.write(tmp_path / "lab.json")
    assert Site.read(tmp_path / "lab.json") == site
    assert pickle.loads(pickle.dumps(site)) == site
    assert json.loads((tmp_path / "lab.json").read_text())["cameras"]["wrist"]["options"] == {"a": 1}


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("{", "cannot be read"),
        ('{"arm": {}}', "Valid fields"),
        ('{"arms": []}', "mapping"),
        ('{"arms": {"fr3": 3}}', "'fr3' is given as 3"),
        ('{"arms": {"fr3": {"adress": "x"}}}', "'driver', 'address'"),
        ('{"on_stale": "cry"}', "'flag', 'hold', 'fault'"),
        ('{"stale_after": 0}', "above 0"),
        ('{"stale_after": NaN}', "above 0"),
        ('{"stale_after": Infinity}', "above 0"),
        ('{"stale_after": true}', "above 0"),
        ('{"arms": {"fr3": {"driver": "fake", "address": 5}}}', "'fr3': The address of a device is 5; valid is a text"),
        ('{"arms": {"fr3": {"driver": 5}}}', "'fr3': The driver of a device is 5"),
        ('{"arms": {"fr3": {"driver": "fake", "options": [1]}}}', "mapping from names to values"),
        ('{"arms": ' * 100_000, "cannot be read"),
    ],
)
def test_a_file_that_is_no_site_is_refused(text: str, match: str, tmp_path: Path) -> None:
    (tmp_path / "lab.json").write_text(text)
    with pytest.raises(InvalidSetup, match=match):
        Site.read(tmp_path / "lab.json")


def test_a_device_itself_goes_into_no_file(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match="fr3"):
        Site(arms={"fr3": home_arm()}).write(tmp_path / "lab.json")


@pytest.mark.parametrize(
    ("hardware", "error", "match"),
    [
        ({"fr4": "fake"}, UnknownName, "Did you mean 'fr3'"),
        ({"fr3": "fack"}, UnknownName, "Did you mean 'fake'"),
        ("no.such.module:Driver", UnknownName, "driver"),
        (3, InvalidSetup, "hardware is 3"),
        (Site(hands={"fr3": "fake"}), InvalidSetup, "carries franka_hand"),
        (Site(arms={"left": "fake"}), UnknownName, "left"),
        ({"fr3": FakeArm(limits_of(FR3).__class__([-1.0], [1.0], [1.0]))}, InvalidSetup, "1 joints"),
        ("nowhere.json", InvalidSetup, "cannot be read"),
        ({"fr3": FakeGripper()}, InvalidSetup, "Expected a device of rcs.devices.Arm"),
        ({"fr3": {"driver": "rcs.errors:WrongOrder"}}, InvalidSetup, "subclass of rcs.hardware.Driver"),
    ],
)
def test_hardware_that_makes_no_sense_is_refused(hardware: Any, error: type[Exception], match: str) -> None:
    with pytest.raises(error, match=match):
        rcs.make("Free", hardware=hardware)


def test_a_driver_says_what_it_does_not_have() -> None:
    class Bare(Driver):
        """Has nothing."""

    with pytest.raises(InvalidSetup, match="Bare has no arms"):
        Bare().arm("", FR3, {})
    assert FakeDriver().arm("a", FR3, {}).name == "a"


def test_nothing_is_connected_before_reset_and_nothing_moves_in_it() -> None:
    arm = home_arm()
    env = rcs.make("Free", hardware={"fr3": arm}, end_effector="none")
    assert not arm.is_open
    assert "fr3 7" in str(env.limits())
    observation, _ = env.reset(seed=0)
    assert arm.is_open
    np.testing.assert_array_equal(observation["joints"], HOME)
    env.close()
    assert not arm.is_open


def test_an_arm_moves_as_told_and_its_body_in_the_world_follows() -> None:
    env = rcs.make("Free", robot="dual_fr3", hardware={"left": "fake"}, frequency=100)
    right = {"right": "simulation", "right/franka_hand": "simulation"}
    assert env.platform == {"left": "fake", "left/franka_hand": "fake", **right}
    start, _ = env.reset(seed=0)
    step = {"joints": np.full(7, 0.005), "gripper": np.zeros(1, np.float32)}
    for _ in range(20):
        observation, *_ = env.step({"left": step, "right": step})
    left, right = (robot.joints for robot in env.scenario.robots)
    for side in ("left", "right"):
        assert np.abs(observation[side]["joints"] - start[side]["joints"] - 0.1).max() < 0.05
    assert np.abs(left - observation["left"]["joints"]).max() < 0.05
    assert np.abs(right - left).max() < 0.05
    env.close()


def test_synchronous_steps_are_not_mixed() -> None:
    with pytest.raises(InvalidSetup, match="realtime"):
        rcs.make("Free", robot="dual_fr3", hardware={"left": "fake"}, stepping="sync")


def test_a_fault_of_one_device_ends_the_episode_and_recover_brings_it_back() -> None:
    arm = home_arm()
    env = rcs.make("Free", hardware={"fr3": arm, "fr3/gripper": "fake"}, frequency=100)
    env.reset(seed=0)
    arm.trip("collision")
    *_, truncated, info = env.step(env.action_space.sample())
    assert truncated
    assert info["end"] == "fault"
    assert "collision" in info["faults"]["fake arm"]
    with pytest.raises(DeviceFault, match="collision"):
        env.reset(seed=0)
    env.recover()
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()
