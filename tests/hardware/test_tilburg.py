"""The Tilburg Hand over its vendor's library, against the hand of a virtual robot on a pseudo-terminal."""

from __future__ import annotations

import contextlib
import io
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.devices import Hand
from rcs.envs.setup import Setup
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.tilburg import CURRENT_BASED_POSITION, GOAL_CURRENT, MODE, TORQUE, TilburgDriver
from rcs.hardware.usb import UsbDevice
from rcs.robots import TILBURG_HAND
from rcs.testing import HandContract
from rcs.virtual import VirtualProcess

pytest.importorskip("tilburg_hand", reason="needs the vendor's library, tilburg-hand")
pytestmark = pytest.mark.hardware
ADDRESS = f"127.{64 + (os.getpid() >> 8) % 64}.{os.getpid() % 250 + 1}.4"


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[VirtualProcess]:
    path = tmp_path_factory.mktemp("setup") / "setup.json"
    path.write_text(json.dumps(Setup(task="Free", robot="ur5e", end_effector="tilburg_hand").to_json()))
    with VirtualProcess("ur5e", address=ADDRESS, setup=path) as process:
        yield process


@pytest.fixture(autouse=True)
def mended(served: VirtualProcess) -> Iterator[None]:
    yield
    served.tell("clear")


def made(served: VirtualProcess, **options: Any) -> Hand:
    entry: Any = served.site.hands["ur5e"]
    return TilburgDriver().hand(entry.address, TILBURG_HAND, options)


def arrive(hand: Hand, joints: Any) -> None:
    hand.command_joints(np.array(joints))
    end = time.monotonic() + 60.0
    while np.abs(hand.state().joints - joints).max() > 0.03:
        assert time.monotonic() < end, hand.state().joints - joints
        time.sleep(0.02)


def look(hand: Hand) -> None:
    for _ in range(100):
        hand.state()
        time.sleep(0.01)


def test_it_goes_where_it_is_told_and_changes_no_list(served: VirtualProcess) -> None:
    with made(served) as hand:
        joints = np.full(16, 0.3)
        arrive(hand, joints)
        np.testing.assert_array_equal(joints, 0.3)
        arrive(hand, np.array(TILBURG_HAND.open_pose))


def test_it_prints_nothing_and_leaves_the_home_folder_alone(
    served: VirtualProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), made(served) as hand:
        hand.state()
    assert printed.getvalue() == ""
    assert list(tmp_path.iterdir()) == []
    assert os.environ["HOME"] == str(tmp_path)


def test_opening_switches_nothing_on(served: VirtualProcess) -> None:
    with made(served) as hand:
        before = hand.state().joints
        time.sleep(0.3)
        np.testing.assert_allclose(hand.state().joints, before, atol=0.01)
        assert not hand._read(TORQUE, 1).any()  # pyright: ignore[reportAttributeAccessIssue]


def test_the_first_command_bounds_the_current_of_every_motor(served: VirtualProcess) -> None:
    with made(served, current=150) as hand:
        hand.command_joints(hand.state().joints)
        assert (hand._read(MODE, 1) == CURRENT_BASED_POSITION).all()  # pyright: ignore[reportAttributeAccessIssue]
        assert (hand._read(GOAL_CURRENT, 2) == 150).all()  # pyright: ignore[reportAttributeAccessIssue]


def test_it_is_found_by_the_serial_number_of_its_adapter(
    served: VirtualProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry: Any = served.site.hands["ur5e"]
    adapter = UsbDevice(path="1-2", serial="FT1", product="USB Serial")
    monkeypatch.setattr("rcs.hardware.serial_port.usb_devices", lambda: [adapter])
    monkeypatch.setattr("rcs.hardware.serial_port.port_of", lambda device: entry.address.removeprefix("/dev/"))
    with TilburgDriver().hand("FT1", TILBURG_HAND, {}) as hand:
        assert len(hand.state().joints) == 16
    with pytest.raises(InvalidSetup, match="FT1"), TilburgDriver().hand("FT2", TILBURG_HAND, {}):
        pass


def test_a_finger_that_is_missing_is_a_fault_that_names_the_motors_that_answer(served: VirtualProcess) -> None:
    served.tell("hand/missing", "index")
    hand = made(served)
    with pytest.raises(DeviceFault, match=r"motors of index_dip, .*index_abd do not answer; those that do: thumb_ip"):
        hand.open()
    served.tell("hand/clear")
    with hand:
        served.tell("hand/missing", "ring")
        with pytest.raises(DeviceFault, match="no answer from the motors of"):
            hand.state()


def test_an_overloaded_finger_is_a_fault_and_recover_restarts_its_motors(served: VirtualProcess) -> None:
    with made(served) as hand:
        arrive(hand, np.full(16, 0.3))
        served.tell("hand/overload", "middle")
        with pytest.raises(DeviceFault, match=r"middle_dip has error 32: it is overloaded.*recover, which restarts"):
            look(hand)
        with pytest.raises(DeviceFault, match="middle_dip has error 32"):
            hand.recover()
        served.tell("hand/clear")
        hand.recover()
        arrive(hand, np.full(16, 0.4))


@pytest.mark.parametrize("recovers", [True, False])
def test_all_motors_are_off_after_a_hand_with_an_overloaded_finger_is_closed(
    served: VirtualProcess, recovers: bool
) -> None:
    with made(served) as hand:
        arrive(hand, np.full(16, 0.3))
        served.tell("hand/overload", "index")
        with pytest.raises(DeviceFault, match="index"):
            look(hand)
        if recovers:
            served.tell("hand/clear")
            hand.recover()
    served.tell("hand/clear")
    with made(served) as hand:
        assert not any(hand._read(TORQUE, 1))  # pyright: ignore[reportAttributeAccessIssue]
        hand.recover()


def test_a_hand_without_power_is_closed_in_time(served: VirtualProcess) -> None:
    with made(served) as hand:
        arrive(hand, np.full(16, 0.3))
        for finger in ("thumb", "index", "middle", "ring"):
            served.tell("hand/missing", finger)
        with pytest.raises(DeviceFault, match="no answer from the motors"):
            look(hand)
        begin = time.monotonic()
        hand.close()
        assert time.monotonic() - begin < 2.5


def test_a_hand_that_may_still_be_powered_is_told(served: VirtualProcess, caplog: pytest.LogCaptureFixture) -> None:
    with made(served) as hand:
        arrive(hand, np.full(16, 0.3))
        served.tell("cut")
        with pytest.raises(DeviceFault):
            look(hand)
        with pytest.raises(DeviceFault, match="recover failed"):
            hand.recover()
    assert "may still be powered: the hand is not connected" in caplog.text


def test_fingers_that_stand_still_keep_their_goal_in_a_hold(served: VirtualProcess) -> None:
    """On an object, a finger stands still away from its goal, and would drop the object without one."""
    with made(served) as hand:
        arrive(hand, np.full(16, 0.3))
        time.sleep(0.5)
        hand.hold()
        np.testing.assert_array_equal(hand._goal, 0.3)  # pyright: ignore[reportAttributeAccessIssue]
        hand.command_joints(np.full(16, 0.6))
        time.sleep(0.1)
        hand.hold()
        stopped = hand.state().joints
        time.sleep(0.3)
        np.testing.assert_allclose(hand.state().joints, stopped, atol=0.05)
        assert np.max(stopped) < 0.58
        arrive(hand, np.array(TILBURG_HAND.open_pose))


def test_recover_lets_go_of_nothing_that_healthy_fingers_hold(
    served: VirtualProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcs.hardware.tilburg.REBOOTING", 0.05)
    hand: Any = made(served)
    with hand:
        arrive(hand, np.full(16, 0.3))
        time.sleep(0.5)
        hand._disconnect()
        hand.set_fault("the link is lost")
        hand.recover()
        assert hand._read(TORQUE, 1).all()
        np.testing.assert_allclose(hand._goal, 0.3, atol=1e-3)
        served.tell("hand/overload", "index")
        with pytest.raises(DeviceFault, match="index"):
            look(hand)
        served.tell("hand/clear")
        hand.recover()
        others = np.array([not name.startswith("index") for name in TILBURG_HAND.joints])
        np.testing.assert_array_equal(hand._read(TORQUE, 1), others)
        np.testing.assert_allclose(hand._goal[others], 0.3, atol=1e-3)


def test_fingers_have_not_arrived_before_they_begin_to_move(
    served: VirtualProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    with made(served) as hand:
        arrive(hand, np.full(16, 0.3))
        monkeypatch.setattr("rcs.hardware.tilburg.STILL", 1e6)
        hand.command_joints(np.full(16, 0.5))
        assert not hand.has_arrived()


def test_options_are_checked() -> None:
    driver = TilburgDriver()
    for options, words in (
        ({"current": 5000}, "20 to 1000"),
        ({"side": "both"}, "'right', 'left'"),
        ({"at_close": "stay"}, "'release', 'hold'"),
        ({"speed": 1}, "speed"),
    ):
        with pytest.raises(InvalidSetup, match=words):
            driver.hand("/dev/null", TILBURG_HAND, options)
    with (
        pytest.raises(DeviceFault, match=r"There is no hand at.*Plugged in: "),
        driver.hand("/dev/ttyNONE", TILBURG_HAND, {}),
    ):
        pass


def test_an_environment_moves_it_in_its_host(served: VirtualProcess) -> None:
    hands = {"ur5e": served.site.hands["ur5e"]}
    hardware = rcs.Site(arms={"ur5e": "fake"}, hands=hands, valid_for=5.0, stale_after=5.0)  # on a busy machine
    setup = Setup(task="Free", robot="ur5e", end_effector="tilburg_hand", binary_gripper=False, max_episode_steps=None)
    with rcs.make(setup, hardware=hardware) as env:
        env.reset()
        end = time.monotonic() + 30.0
        observation: Any = {"hand": np.ones(16)}
        while np.abs(observation["hand"] - 0.25).max() > 0.05:
            assert time.monotonic() < end, observation["hand"]
            action = {"joints": np.zeros(6), "hand": np.full(16, 0.25, np.float32)}
            observation, _, _, truncated, info = env.step(action)
            assert not truncated, info


@pytest.mark.slow
class TestOverTheWire(HandContract):
    """The contract, with the virtual hand of the module."""

    tolerance = 0.04
    distance = 0.2  # farther, fingers would meet
    # Of a busy machine, on which the virtual motors move late:
    max_age = 1.0
    stopping_time = 0.5
    time_limit = 30.0

    @pytest.fixture(autouse=True)
    def _serve(self, served: VirtualProcess) -> None:
        self.served = served
        with made(served) as hand:
            arrive(hand, np.array(TILBURG_HAND.open_pose))

    def make_device(self) -> Hand:
        return made(self.served)

    def lose_link(self, device: Hand) -> None:
        self.served.tell("cut")

    def restore_link(self, device: Hand) -> None:
        self.served.tell("clear")
