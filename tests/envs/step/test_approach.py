"""Real arms go to the start of an episode slowly, and only when a person has agreed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.devices import ArmLimits
from rcs.devices.fakes import FakeArm, FakeGripper
from rcs.envs.env import Env
from rcs.errors import DeviceFault, InvalidAction, InvalidSetup, Refused, WrongOrder
from rcs.hardware import Site
from rcs.robots.fr3 import FR3

HOME = np.array(FR3.home)
THERE = {"joints": HOME + 0.2, "gripper": np.zeros(1, np.float32)}


class TracedArm(FakeArm):
    """Remembers what it was sent, and when."""

    def __init__(self, limits: ArmLimits | None = None, start: np.ndarray = HOME) -> None:
        super().__init__(limits or FR3.arm_limits, start=start)
        self.sent: list[tuple[float, np.ndarray]] = []

    def _command_joints(self, joints: np.ndarray) -> None:
        self.sent.append((time.monotonic(), np.array(joints)))
        super()._command_joints(joints)


class Holding(FakeGripper):
    """Has something between its open fingers, and remembers what it was sent."""

    def __init__(self) -> None:
        super().__init__(speed=0.0)
        self.sent: list[float] = []

    def _command_opening(self, opening: float, force: float | None) -> None:
        self.sent.append(opening)
        super()._command_opening(opening, force)


def make(arm: FakeArm, gripper: FakeGripper | None = None, **options: Any) -> Env:
    grippers = {"fr3": gripper or FakeGripper(speed=5.0)}
    site = Site(arms={"fr3": arm}, grippers=grippers, arm_stale_after=60.0, stale_after=60.0)
    return rcs.make("Free", hardware=site, frequency=50.0, **options)


def test_an_arm_goes_where_it_is_wanted_and_no_faster_than_it_may() -> None:
    arm, asked = TracedArm(), list[str]()

    def agree(question: str) -> bool:
        assert not arm.sent, "nothing moves before the answer"
        asked.append(question)
        return True

    with make(arm) as env:
        options = {"robot": THERE, "may_move": agree, "speed": 0.2}
        observation, _ = env.reset(seed=0, options=options)
        np.testing.assert_allclose(observation["joints"], THERE["joints"], atol=1e-6)
        assert observation["gripper"] < 0.1
        (question,) = asked
        assert "fr3 by up to 0.20 rad (joint4) in 1 s, at 20 % of the largest speed" in question
        targets = np.array([joints for _, joints in arm.sent])
        assert np.abs(np.diff(targets, axis=0, prepend=[HOME])).max() * 50.0 < 0.2 * min(FR3.velocity_limit) * 1.01
        duration = arm.sent[-1][0] - arm.sent[0][0]
        assert duration > 0.2 / (0.2 * min(FR3.velocity_limit))
        observation, *_ = env.step({"joints": np.zeros(7), "gripper": np.zeros(1)})
        np.testing.assert_allclose(observation["joints"], THERE["joints"], atol=1e-6)


@pytest.mark.parametrize("control", ["tquat", "xyzrpy", "twist"])
def test_an_arm_goes_there_whatever_its_actions_are(control: Any) -> None:
    with make(TracedArm(), control=control) as env:
        observation, _ = env.reset(seed=0, options={"robot": THERE, "may_move": True, "speed": 1.0})
        np.testing.assert_allclose(observation["joints"], THERE["joints"], atol=1e-6)
        observation, *_ = env.step({control: np.eye(7)[6] if control == "tquat" else np.zeros(6), "gripper": [0.0]})
        np.testing.assert_allclose(observation["joints"], THERE["joints"], atol=1e-3)


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"robot": THERE}, InvalidSetup, "moves real arms \\(fr3\\), and nobody can be asked"),
        ({"robot": THERE, "may_move": False}, Refused, "nobody agreed"),
        ({"robot": THERE, "may_move": lambda question: False}, Refused, "Move fr3 by up to 0.20 rad"),
        ({"robot": THERE, "may_move": lambda question: "no"}, Refused, "nobody agreed"),
        ({"robot": THERE, "may_move": "yes"}, InvalidSetup, "may_move"),
        ({"robot": THERE, "may_move": True, "speed": 1.5}, InvalidSetup, "'speed' is 1.5"),
        ({"robot": THERE, "may_move": True, "speed": float("nan")}, InvalidSetup, "'speed' is nan"),
        ({"robot": {"joints": HOME + 9.0}, "may_move": True}, InvalidSetup, "valid is"),
        ({"robot": {"joints": HOME[:3]}, "may_move": True}, InvalidSetup, "shape"),
        ({"robot": THERE, "may_mvoe": True}, InvalidSetup, "Did you mean 'may_move'"),
        ({"objects": {"cuboid": np.zeros(7)}}, InvalidSetup, "poses of \\[\\]"),
        ({"state": np.zeros(3)}, WrongOrder, "no simulated world"),
    ],
)
def test_without_leave_or_sense_nothing_moves(options: dict[str, Any], error: type[Exception], match: str) -> None:
    arm = TracedArm()
    with make(arm) as env:
        with pytest.raises(error, match=match):
            env.reset(seed=0, options=options)
        assert not arm.sent
        np.testing.assert_array_equal(arm.body.values, HOME)


def test_who_is_found_outside_of_its_range_stays_there_while_another_arm_goes() -> None:
    narrow = FR3.within(ArmLimits(list(HOME - 0.3), list(HOME + 0.3), list(FR3.velocity_limit)), "narrow")
    left, right = TracedArm(), TracedArm(narrow.arm_limits, HOME + 0.4)
    site = Site(arms={"left": left, "right": right}, arm_stale_after=60.0)
    with rcs.make("Free", robot="dual_fr3", end_effector=None, hardware=site, frequency=50.0) as env:
        env.reset(seed=0, options={"robot": {"left": {"joints": HOME + 0.2}}, "may_move": True, "speed": 0.5})
        np.testing.assert_allclose(left.body.values, HOME + 0.2, atol=1e-6)
        np.testing.assert_allclose(right.body.values, HOME + 0.4, atol=1e-9)
        way = {"joints": HOME}
        env.reset(options={"robot": {"right": way}, "may_move": True, "speed": 0.5})
        np.testing.assert_allclose(right.body.values, HOME, atol=1e-6)
    assert np.abs(np.diff([joints for _, joints in right.sent], axis=0)).max() < 0.03


def test_a_gripper_keeps_hold_on_the_way_of_what_was_put_in_it() -> None:
    gripper = Holding()
    with make(TracedArm(), gripper) as env:
        env.reset(seed=0)
        env.step({"joints": np.zeros(7), "gripper": np.zeros(1)})
        env.hold()
        observation, _ = env.reset(options={"robot": {"joints": HOME}, "may_move": True})
        assert observation["gripper"] == 1.0
    assert len(gripper.sent) > 10
    assert set(gripper.sent) == {0.0}


def test_an_arm_that_sags_is_not_waited_for_at_every_point_of_its_way() -> None:
    arm, asked = TracedArm(), list[int]()

    def has_arrived() -> bool:
        asked.append(len(arm.sent))
        return False

    arm._has_arrived = has_arrived  # pyright: ignore[reportAttributeAccessIssue]
    with make(arm, stepping="sync", sync_time_limit=0.05) as env:
        env.reset(options={"robot": {"joints": HOME}, "may_move": True})
        assert len(arm.sent) > 10
        assert not asked


def test_a_way_that_a_device_refuses_is_no_start() -> None:
    arm = TracedArm()
    with make(arm) as env:
        env.reset(seed=0)

        def refuse(joints: np.ndarray) -> None:
            raise InvalidAction("too far away")

        arm._command_joints = refuse  # pyright: ignore[reportAttributeAccessIssue]
        with pytest.raises(InvalidAction, match="too far away"):
            env.reset(options={"robot": THERE, "may_move": True})
        del arm._command_joints
        with pytest.raises(WrongOrder, match="InvalidAction"):
            env.step({"joints": np.zeros(7), "gripper": np.zeros(1)})


def test_a_fault_on_the_way_stops_all_arms_and_is_told() -> None:
    arm = TracedArm()
    command: Callable[[np.ndarray], None] = arm._command_joints

    def trip(joints: np.ndarray) -> None:
        command(joints)
        if len(arm.sent) == 5:
            arm.set_fault("touched something")

    arm._command_joints = trip  # pyright: ignore[reportAttributeAccessIssue]
    with make(arm) as env:
        with pytest.raises(DeviceFault, match="touched something"):
            env.reset(seed=0, options={"robot": THERE, "may_move": True})
        assert len(arm.sent) == 5
        assert np.abs(arm.body.values - HOME).max() < 0.1


def test_an_environment_that_is_closed_on_the_way_stops_all_arms() -> None:
    arm = TracedArm()
    command, hold = arm._command_joints, arm._hold
    held = threading.Event()

    def close_meanwhile(joints: np.ndarray) -> None:
        command(joints)
        if len(arm.sent) == 5:
            threading.Thread(target=env.close).start()
            assert held.wait(10)

    arm._command_joints = close_meanwhile  # pyright: ignore[reportAttributeAccessIssue]
    arm._hold = lambda: (hold(), held.set())  # pyright: ignore[reportAttributeAccessIssue]
    with make(arm) as env:
        with pytest.raises(Refused):
            env.reset(seed=0, options={"robot": THERE, "may_move": True})
        assert len(arm.sent) <= 6
        assert np.abs(arm.body.values - HOME).max() < 0.1


def test_an_arm_that_does_not_arrive_is_no_start() -> None:
    arm = TracedArm()
    with make(arm) as env:
        env.reset(seed=0)
        arm.body._speed = np.zeros(7)
        with pytest.raises(DeviceFault, match=r"fr3 has not arrived: joint\d is 0\.20 rad"):
            env.reset(seed=0, options={"robot": THERE, "may_move": True, "speed": 1.0})


def test_the_robot_that_is_simulated_is_put_there_and_the_real_one_goes() -> None:
    arm = TracedArm()
    site = Site(arms={"left": arm}, grippers={"left": FakeGripper()}, arm_stale_after=60.0, stale_after=60.0)
    with rcs.make("Free", robot="dual_fr3", hardware=site, frequency=50.0) as env:
        wanted = {"left": {"joints": HOME + 0.1}, "right": {"joints": HOME - 0.3}}
        observation, _ = env.reset(seed=0, options={"robot": wanted, "may_move": True, "speed": 0.5})
        np.testing.assert_allclose(observation["left"]["joints"], HOME + 0.1, atol=1e-6)
        np.testing.assert_allclose(observation["right"]["joints"], HOME - 0.3, atol=0.02)
        arm.sent.clear()
        observation, _ = env.reset(seed=0, options={"robot": {"right": wanted["right"]}})
        assert not arm.sent, "a simulated robot needs no leave"
