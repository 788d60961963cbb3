"""The hand of an FR3, through the vendor's interface and `franky-control` as installed, before a virtual robot."""

from __future__ import annotations

import threading
import time
from collections.abc import Generator
from typing import Any

import numpy as np
import pytest
from moving import stream, wait_until, wave
from virtual_fr3 import ADDRESS, an_arm, virtual_fr3

import rcs
from rcs.agents import PickExpert
from rcs.errors import DeviceFault, WrongOrder
from rcs.hardware.franka import FrankaArm
from rcs.hardware.franka_hand import FrankaHand
from rcs.robots import FRANKA_HAND
from rcs.testing import GripperContract
from rcs.virtual import VirtualProcess

pytest.importorskip("franky", reason="needs franky-control, the extra 'franka'")
pytestmark = pytest.mark.hardware


@pytest.fixture(scope="module")
def robot() -> Generator[VirtualProcess]:
    with virtual_fr3() as process:
        yield process


@pytest.fixture(autouse=True)
def _mended(robot: VirtualProcess) -> Generator[None]:
    robot.tell("clear")
    yield
    robot.tell("clear")


@pytest.fixture
def arm(robot: VirtualProcess) -> Generator[FrankaArm]:
    with an_arm() as arm:
        yield arm


@pytest.mark.slow
class TestFrankaHand(GripperContract):
    stopping_time = 0.4

    @pytest.fixture(autouse=True)
    def _robot(self, robot: VirtualProcess) -> None:
        self.robot = robot
        robot.tell("clear")

    def make_device(self) -> FrankaHand:
        return FrankaHand(ADDRESS, FRANKA_HAND)


class Counting:
    """The library's hand, which counts the calls of `stop` that are made at once."""

    def __init__(self, hand: Any) -> None:
        self.hand, self.now, self.most, self.stops = hand, 0, 0, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.hand, name)

    def stop(self) -> bool:
        self.now, self.stops = self.now + 1, self.stops + 1
        self.most = max(self.most, self.now)
        time.sleep(0.05)
        stopped = self.hand.stop()
        self.now -= 1
        return bool(stopped)


def test_the_library_gets_one_stop_at_a_time_and_a_newer_motion_none():
    with FrankaHand(ADDRESS, FRANKA_HAND) as hand:
        hand.command_opening(1.0)
        wait_until(hand.has_arrived)
        counting = hand._hand = Counting(hand._hand)
        hand.command_opening(0.0, 20.0)
        wait_until(lambda: hand._is_busy)
        holding = threading.Thread(target=hand.hold)
        holding.start()
        wait_until(lambda: counting.now == 1)
        hand.command_opening(0.5, 20.0)
        holding.join()
        assert (counting.most, counting.stops) == (1, 1)
        wait_until(hand.has_arrived)
        assert hand.state().opening == pytest.approx(0.5, abs=0.02)


def test_fingers_close_while_the_arm_moves_and_nobody_waits_for_them(arm: FrankaArm):
    with FrankaHand(ADDRESS, FRANKA_HAND) as hand:
        hand.command_opening(1.0)
        wait_until(hand.has_arrived)
        began = time.monotonic()
        hand.command_opening(0.0, 20.0)
        for _ in range(20):
            hand.state()
        assert time.monotonic() - began < 0.2
        stream(arm, wave(arm, 0.05, 1.0))
        wait_until(hand.has_arrived)
        assert hand.state().opening == pytest.approx(0.0, abs=0.02)
        hand.home()
        wait_until(lambda: hand.state().opening > 0.95)
        hand.command_opening(0.0, 20.0)  # the same as before: the fingers are elsewhere now
        wait_until(lambda: hand.state().opening < 0.1)
        assert arm.fault == ""


def test_homing_stands_at_a_hold_and_is_refused_in_the_fault_state(robot: VirtualProcess):
    with FrankaHand(ADDRESS, FRANKA_HAND) as hand:
        hand.command_opening(0.0)
        wait_until(hand.has_arrived)
        errors: list[Exception] = []

        def home() -> None:
            try:
                hand.home()
            except WrongOrder as err:
                errors.append(err)

        homing = threading.Thread(target=home)
        homing.start()
        wait_until(lambda: hand.state().opening > 0.1)
        with pytest.raises(WrongOrder, match="being homed"):
            hand.command_opening(0.0)
        hand.hold()
        homing.join(5.0)
        assert "a hold has ended the homing" in str(errors[0])
        time.sleep(0.3)
        stands = hand.state().opening
        assert stands < 0.9
        time.sleep(0.3)
        assert hand.state().opening == pytest.approx(stands, abs=0.05)
        hand.set_fault("pressed")
        with pytest.raises(DeviceFault, match=r"home is refused in the fault state \(pressed\)"):
            hand.home()
        assert hand.state().opening == pytest.approx(stands, abs=0.05)


def test_a_time_of_the_hand_is_a_time(robot: VirtualProcess):
    with FrankaHand(ADDRESS, FRANKA_HAND) as hand:
        states = []
        for _ in range(400):
            states.append(hand.state())
            time.sleep(0.005)
    seen, at = (np.array([getattr(state, name) for state in states]) for name in ("time", "device_time"))
    assert len(set(seen)) > 30, "it sends 30 a second"
    assert np.isnan(at).all() or np.ptp(at) == pytest.approx(np.ptp(seen), rel=0.2), "no count of messages"


def test_a_hold_before_the_fingers_begin_to_move_stops_them(robot: VirtualProcess, monkeypatch: pytest.MonkeyPatch):
    with FrankaHand(ADDRESS, FRANKA_HAND) as hand:
        hand.command_opening(1.0)
        wait_until(hand.has_arrived)
        is_held = threading.Event()
        monkeypatch.setattr(hand, "_move", lambda library, *_: is_held.wait(5.0) and library.move(0.0, 0.05))
        hand.command_opening(0.0)
        wait_until(lambda: hand._is_busy)
        hand.hold()
        is_held.set()
        wait_until(hand.has_arrived)
        assert hand.state().opening > 0.8


def test_a_hand_whose_cable_was_out_is_connected_again_by_recover(robot: VirtualProcess):
    with FrankaHand(ADDRESS, FRANKA_HAND) as hand:
        robot.tell("cut")
        with pytest.raises(DeviceFault, match="hand"):  # noqa: PT012  until its last state is too old
            for _ in range(500):
                hand.state()
                time.sleep(0.01)
        time.sleep(1.5)
        with pytest.raises(DeviceFault):
            hand.recover()
        robot.tell("clear")
        hand.recover()
        for opening in (0.5, 1.0):
            hand.command_opening(opening)
            wait_until(hand.has_arrived)
            assert hand.state().opening == pytest.approx(opening, abs=0.03)
        assert hand.fault == ""


def test_what_picks_a_cuboid_in_simulation_picks_the_virtual_robots_cuboid(robot: VirtualProcess):
    """Joints and gripper of a simulated pick, sent through an environment to the arm and the hand."""
    with rcs.make("PickCuboid", robot="fr3", control="xyzrpy", relative=False) as env:
        expert = PickExpert(env)
        obs, info = env.reset(seed=5)
        expert.reset(obs, info)
        done, actions = False, []
        while not done:
            action = expert.act(obs, info)
            obs, _, done, _, info = env.step(action)
            actions.append({"joints": obs["joints"], "gripper": action["gripper"]})
        held = obs["gripper"]
    robot.tell("reset", 5)
    an_arm().close()
    with rcs.make("PickCuboid", robot="fr3", hardware=robot.site, control="joints", relative=False) as env:
        obs, info = env.reset(seed=5)
        start = obs["joints"]
        for way in np.linspace(start, actions[0]["joints"], 60):
            env.step({"joints": way, "gripper": np.array([1.0], np.float32)})
        for action in [*actions, *[actions[-1]] * 15]:
            obs, _, _, is_over, info = env.step(action)
            assert not is_over, info
        assert obs["gripper"] == pytest.approx(held, abs=0.02)
        assert obs["joints"] == pytest.approx(actions[-1]["joints"], abs=0.02)
