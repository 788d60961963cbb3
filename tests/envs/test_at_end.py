"""Real arms hold when their environment is closed, or go home slowly where all is in order."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.devices.fakes import FakeArm, FakeGripper
from rcs.envs.env import Env
from rcs.errors import InvalidSetup, Refused
from rcs.robots import FR3

HOME = np.array(FR3.home)
AWAY = HOME + 0.03


class WatchedArm(FakeArm):
    """Tells when it is sent home."""

    def __init__(self) -> None:
        super().__init__(FR3.arm_limits, start=AWAY)
        self.on_command: Callable[[], None] = lambda: None
        self.sent = [AWAY]

    def _command_joints(self, joints: Any) -> None:
        self.sent.append(np.array(joints))
        super()._command_joints(joints)
        self.on_command()


def make(arm: FakeArm, **options: Any) -> Env:
    return rcs.make("Free", hardware={"fr3": arm, "fr3/gripper": FakeGripper()}, frequency=50.0, **options)


def test_an_arm_that_parks_goes_home_slowly_and_is_closed() -> None:
    arm = WatchedArm()
    with make(arm, at_end="park") as env:
        env.reset()
        assert len(arm.sent) == 1
    np.testing.assert_allclose(arm.body.values, HOME, atol=1e-6)
    assert np.abs(np.diff(arm.sent, axis=0)).max() * 50.0 < 0.05 * min(FR3.velocity_limit) * 1.01
    assert not arm.is_open
    env.close()


def test_an_arm_that_holds_stays_where_it_is() -> None:
    arm = WatchedArm()
    with make(arm) as env:
        env.reset()
    np.testing.assert_array_equal(arm.sent, [AWAY])


def test_an_arm_does_not_park_after_an_error() -> None:
    arm = WatchedArm()
    env = make(arm, at_end="park")
    env.reset()
    with pytest.raises(ZeroDivisionError), env:
        _ = 1 / 0
    assert not arm.is_open
    np.testing.assert_array_equal(arm.sent, [AWAY])


def test_an_arm_does_not_park_in_fault_nor_before_it_was_opened() -> None:
    arm = WatchedArm()
    with make(arm, at_end="park"):
        pass
    with make(arm, at_end="park") as env:
        env.reset()
        arm.set_fault("stop")
    assert not arm.is_open
    np.testing.assert_array_equal(arm.sent, [AWAY])


def test_another_thread_has_an_arm_hold_that_parks() -> None:
    arm = WatchedArm()
    env = make(arm, at_end="park")
    env.reset()

    def hold_once() -> None:
        if len(arm.sent) == 8:
            holding = threading.Thread(target=env.hold)
            holding.start()
            holding.join()

    arm.on_command = hold_once
    with pytest.raises(Refused, match="while the arms were on their way; they stay where they are"):
        env.close()
    assert not arm.is_open
    assert len(arm.sent) == 8
    assert np.abs(arm.body.values - HOME).min() > 1e-3


def test_ctrl_c_ends_parking() -> None:
    arm = WatchedArm()
    env = make(arm, at_end="park")
    env.reset()

    def interrupt() -> None:
        if len(arm.sent) == 8:
            raise KeyboardInterrupt

    arm.on_command = interrupt
    with pytest.raises(KeyboardInterrupt):
        env.close()
    assert not arm.is_open
    assert len(arm.sent) == 8
    assert np.abs(arm.body.values - HOME).min() > 1e-3


def test_there_is_no_other_end() -> None:
    with pytest.raises(InvalidSetup, match="at_end is 'drop'; valid: 'hold', 'park'"):
        rcs.Setup(at_end="drop")  # pyright: ignore[reportArgumentType]
