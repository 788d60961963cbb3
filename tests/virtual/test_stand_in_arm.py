"""A stand-in is an arm as the contract says, obeys late, and measures with noise."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.errors import DeviceFault, InvalidSetup
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.testing import ArmContract
from rcs.virtual import SimDriver, StandInArm

HOME = np.array(FR3.home)


class HandClock:
    """A clock that tests move by hand [s]."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def standing(clock: HandClock, **options: Any) -> StandInArm:
    arm = StandInArm(FR3, clock=clock, **options)
    arm.open()
    return arm


class TestStandInArm(ArmContract):
    stopping_time = 0.5  # its targets stop at once, and the wrist with the hand then swings for a while

    def make_device(self) -> StandInArm:
        self.arm = StandInArm(FR3, gripper=FRANKA_HAND, delay=0.02)
        return self.arm

    def lose_link(self, device: Any) -> None:
        device.lose_link()

    def restore_link(self, device: Any) -> None:
        device.restore()


@pytest.mark.parametrize("delay", [0.0, 0.01, 0.05])
def test_it_begins_to_move_when_the_delay_has_passed(delay: float) -> None:
    clock = HandClock()
    with standing(clock, delay=delay) as arm:
        arm.command_joints(HOME + 0.3)
        clock.now += delay
        np.testing.assert_allclose(arm.state().joints, HOME, atol=1e-6)
        clock.now += 0.05
        assert (arm.state().joints > HOME + 1e-3).all()
        clock.now += 0.9
        arm.state()
        clock.now += 0.9
        np.testing.assert_allclose(arm.state().joints, HOME + 0.3, atol=2e-3)
        assert arm.has_arrived()


def test_how_often_it_is_asked_does_not_change_how_it_moves() -> None:
    joints = []
    for looks in (1, 7, 50):
        clock = HandClock()
        with standing(clock, delay=0.03) as arm:
            arm.command_joints(HOME + 0.2)
            for _ in range(looks):
                clock.now += 0.4 / looks
                arm.state()
            clock.now = 100.4
            joints.append(arm.state().joints)
    np.testing.assert_allclose(joints, [joints[0]] * 3, atol=1e-12)


def test_noise_is_of_the_measurement_alone_and_seeded() -> None:
    states = []
    for seed in (1, 1, 2):
        with standing(HandClock(), noise=1e-3, seed=seed) as arm:
            states.append(np.array([arm.state().joints for _ in range(200)]))
    np.testing.assert_array_equal(states[0], states[1])
    assert np.abs(states[0] - states[2]).max() > 0
    np.testing.assert_allclose(states[0].std(axis=0), 1e-3, rtol=0.2)


def test_one_that_is_frozen_takes_commands_without_a_word_and_stands_still() -> None:
    clock = HandClock()
    with standing(clock) as arm:
        arm.freeze()
        arm.command_joints(HOME + 0.3)
        clock.now += 0.5
        np.testing.assert_allclose(arm.state().joints, HOME, atol=1e-4)
        assert (arm.fault, arm.state().mode) == ("", "frozen")
        arm.thaw()
        arm.command_joints(HOME + 0.3)
        clock.now += 0.9
        assert (arm.state().joints > HOME + 0.2).all()


def test_hold_drops_what_was_still_on_its_way() -> None:
    clock = HandClock()
    with standing(clock, delay=0.05) as arm:
        arm.command_joints(HOME + 0.3)
        clock.now += 0.01
        arm.hold()
        clock.now += 0.5
        np.testing.assert_allclose(arm.state().joints, HOME, atol=1e-4)


def test_a_lost_link_is_a_fault() -> None:
    with standing(HandClock()) as arm:
        arm.lose_link()
        with pytest.raises(DeviceFault, match="link is lost"):
            arm.state()
        arm.restore()
        arm.recover()
        assert arm.state().mode == "position"


@pytest.mark.parametrize("options", [{"delay": -0.1}, {"noise": -1.0}, {"delay": float("nan")}])
def test_numbers_that_make_no_sense_are_refused(options: Any) -> None:
    with pytest.raises(InvalidSetup, match=next(iter(options))):
        StandInArm(FR3, **options)


def test_the_driver_takes_the_options_of_a_site_and_refuses_others() -> None:
    arm = SimDriver().arm("bench", FR3, {"delay": 0.04, "noise": 1e-4, "gripper": "franka_hand"})
    assert (arm.name, arm.delay) == ("bench", 0.04)
    for options, words in (
        ({"dealy": 0.04}, "Did you mean 'delay'"),
        ({"delay": "0.04"}, "delay is '0.04'; valid: a finite number from 0"),
        ({"noise": None}, "noise is None; valid: a finite number from 0"),
        ({"seed": -1}, "seed is -1; valid: a whole number from 0"),
        ({"smoothing": 0}, "smoothing is 0; valid: a finite number above 0"),
        ({"gripper": 3}, "gripper is 3; valid: a text"),
    ):
        with pytest.raises(InvalidSetup, match=words):
            SimDriver().arm("", FR3, options)


def test_an_environment_drives_it_in_real_time() -> None:
    with rcs.make("Free", hardware="sim", relative=False, frequency=50) as env:
        observation, _ = env.reset()
        assert env.platform == {"fr3": "sim", "fr3/franka_hand": "sim"}
        begin, goal = time.monotonic(), observation["joints"] + 0.05
        for _ in range(50):
            observation, *_ = env.step({"joints": goal, "gripper": np.ones(1, np.float32)})
        assert time.monotonic() - begin > 0.9
        np.testing.assert_allclose(observation["joints"], goal, atol=5e-3)
