"""Foot pedals and keyboards of the robot's own, through events of the kernel."""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rcs_data.files.closing import Closing

import rcs
from rcs.errors import DeviceFault
from rcs.teleop.device import OF_HANDS, HandReading, InputDevice, Reading
from rcs.teleop.feed import Feed, News, with_buttons
from rcs.teleop.input_events import InputEvents
from rcs.teleop.operator import Operator
from rcs.teleop.pedal import Pedal
from rcs.teleop.so101_leader import so101_leader
from tests.teleop.scripted_device import LEVEL, ScriptedDevice, held

A, B, C, W, SPACE = 30, 48, 46, 17, 57
DESCRIPTION = """P: /devices/usb/input/input5
E: SUBSYSTEM=input
A: name=PCsensor FootSwitch
A: id/vendor=3553
A: id/product=b001
A: capabilities/key=1000000000007 ff800000000007ff febeffdff3cfffff fffffffffffffffe

P: /devices/usb/input/input5/event5
N: input/event5
E: DEVNAME=/dev/input/event5
E: SUBSYSTEM=input
L: device=../../input5

"""
"""The part of a pedal that types."""


def beside(number: int, keys: str) -> str:
    """Return the description of another part of the pedal, which has other keys."""
    typing = "1000000000007 ff800000000007ff febeffdff3cfffff fffffffffffffffe"
    return DESCRIPTION.replace(typing, keys).replace("input5", f"input{number}").replace("event5", f"event{number}")


PARTS = DESCRIPTION + beside(6, "1f0000 0 0 0 0") + beside(7, "3007f 0 0 483ffff17aff32d bfd4444600000000 0 0 0")
"""A whole pedal: its keys, its mouse and its media keys."""


def event(kind: int, code: int, value: int) -> bytes:
    return struct.pack("@llHHi", 0, 0, kind, code, value)


def keys(*changes: tuple[int, int, int]) -> dict[str, list[tuple[int, bytes]]]:
    """Return a node with key events: delay [ms], code and value of each."""
    return {"/dev/input/event5": [(delay, event(1, code, value) + event(0, 0, 0)) for delay, code, value in changes]}


@pytest.mark.extras
def test_a_pedal_is_found_and_read_through_the_kernels_files(read_mocked) -> None:
    inputs = keys((200, A, 1), (200, A, 0), (200, B, 1), (0, B, 0))
    lines = read_mocked("rcs.teleop.pedal:Pedal", seconds=1.2, description=PARTS, inputs=inputs)
    assert lines[0] == {"open": True}
    seen = [tuple(line["hands"]["right"]["buttons"]) for line in lines[1:] if "hands" in line]
    changes = [buttons for buttons, before in zip(seen, [None, *seen], strict=False) if buttons != before]
    assert changes == [(), ("clutch",), (), ("gripper",), ()]


@pytest.mark.extras
def test_a_keyboard_of_the_robots_own_is_read_through_the_kernels_files(read_mocked) -> None:
    lines = read_mocked(
        "rcs.teleop.keyboard:Keyboard", seconds=1.2, description=DESCRIPTION, address="/dev/input/event5",
        inputs=keys((100, W, 1), (100, SPACE, 1), (100, SPACE, 0), (100, W, 0)),
    )  # fmt: skip
    hands = [line["hands"]["right"] for line in lines[1:] if "hands" in line]
    assert {"clutch", "gripper"} in [set(hand["buttons"]) for hand in hands]
    assert all(hand["twist"][0] == (0.1 if "clutch" in hand["buttons"] else 0.0) for hand in hands)
    assert hands[-1]["buttons"] == []


@pytest.mark.extras
def test_no_pedal_is_refused_with_the_remedy(read_mocked) -> None:
    (line,) = read_mocked("rcs.teleop.pedal:Pedal", seconds=1)
    assert line["error"] == "DeviceFault" and "ls -l /dev/input/by-id" in line["message"]


def test_keys_are_released_when_events_were_dropped() -> None:
    keys = InputEvents("/dev/input/event0", "keyboard")
    keys.feed(event(1, A, 1) + event(1, B, 1)[:7])
    assert keys.held == {"a"}
    keys.feed(event(1, B, 1)[7:])
    assert keys.held == {"a", "b"}
    keys.feed(event(0, 3, 0))
    assert keys.held == set()
    keys.feed(event(1, A, 2))  # the repetition of a key whose press was lost: it counts once it is pressed again
    assert keys.held == set()


def test_a_file_that_is_no_input_device_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pedal")
    with pytest.raises(DeviceFault, match="is no foot pedal"):
        Pedal(str(tmp_path / "pedal")).open()


def test_a_link_that_may_not_be_read_names_the_rule_of_its_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    (tmp_path / "by-id").symlink_to("/dev/input/event5")
    monkeypatch.setattr("rcs.teleop.input_events.line_of", lambda path: path.parts[-3])
    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(DeviceFault, match=r'ATTRS\{name\}=="event5"'):
        InputEvents(str(tmp_path / "by-id"), "foot pedal").open()


class Still(InputDevice):
    """A device whose own clutch is held, and whose gripper is."""

    valid_for = 20.0  # on a busy machine
    hands = ("left", "right")
    is_open = False

    def open(self) -> None:
        self.is_open = True

    def read(self) -> Reading:
        time.sleep(0.002)
        hand = HandReading(twist=np.zeros(6), buttons=frozenset({"clutch", "gripper"}))
        return Reading(time=time.monotonic(), hands={"left": hand, "right": hand})

    def close(self) -> None:
        self.is_open = False


class Foot(Pedal):
    """A pedal without a file: its keys are what the test gives."""

    fate = ""

    def connect(self) -> InputEvents:
        keys = InputEvents("", "")

        def wait(seconds: float) -> None:
            time.sleep(0.002)
            if self.fate == "lost":
                raise DeviceFault("the cable is out")
            keys.time = keys.time if self.fate else time.monotonic()

        keys.wait = wait  # type: ignore[method-assign]
        return keys

    def feed(self, data: bytes) -> None:
        with self._lock:
            assert self._connection is not None
            self._connection.feed(data)


class Both(Closing):
    """A device and a pedal beside it, as an operator hears them."""

    def __init__(self, device: InputDevice, foot: Foot, *, is_clutch: bool = True) -> None:
        self.feeds, self.is_clutch = (Feed(device), Feed(foot)), is_clutch
        self.asked: list[str] = []
        for feed in self.feeds:
            feed.open()

    def poll(self) -> News:
        leading, foot = self.feeds
        news = with_buttons(leading.poll(), foot.poll(), leading.device.hands, is_clutch=self.is_clutch)
        presses = [one for pressed in news.pressed.values() for one in pressed if one not in OF_HANDS]
        self.asked += [*presses, *news.requests]
        return news

    def until(self, is_true: Callable[[News], bool]) -> News:
        end = time.monotonic() + 20
        while not is_true(news := self.poll()):
            assert time.monotonic() < end, (news, self.asked)
            time.sleep(0.002)
        return news

    def soon_has(self, hand: str, *buttons: str) -> None:
        """Wait until a hand has these buttons and no others."""
        self.until(lambda news: news.reading is not None and news.reading.hands[hand].buttons == set(buttons))

    def wait(self) -> None:
        """Wait until the pedal was read again."""
        before = self.feeds[1].readings
        self.until(lambda _: self.feeds[1].readings >= before + 3)

    def close(self) -> None:
        for feed in self.feeds:
            feed.close()


def test_beside_a_pedal_the_devices_own_clutch_does_not_count() -> None:
    still, foot = Still(), Foot()
    with Both(still, foot) as both:
        both.soon_has("left", "gripper")
        both.wait()
        foot.feed(event(1, A, 1))
        assert "clutch" in both.until(lambda news: bool(news.pressed["left"])).pressed["right"]
        both.soon_has("left", "clutch", "gripper")
        foot.feed(event(1, A, 0))
        both.soon_has("right", "gripper")
        foot.feed(event(1, C, 1) + event(1, C, 0))  # too short to be seen held
        both.until(lambda _: both.asked == ["start"])
        foot.feed(event(1, B, 1) + event(1, B, 0))
        assert both.until(lambda news: bool(news.pressed["left"])).pressed == {
            "left": ["gripper"],
            "right": ["gripper"],
        }
    assert not still.is_open


def test_beside_any_other_device_only_its_clutch_does_not_count() -> None:
    foot = Foot()
    with Both(Still(), foot, is_clutch=False) as both:
        both.wait()
        foot.feed(event(1, A, 1) + event(1, C, 1))
        both.until(lambda news: both.asked == ["start"] and not news.pressed["left"])
        both.soon_has("left", "clutch", "gripper")


def test_every_key_of_a_pedal_with_one_switch_may_be_the_clutch() -> None:
    with Foot("clutch") as foot:
        foot.open()
        foot.feed(event(1, B, 1))
        reading = foot.read()
        assert reading is not None and reading.hands["right"].buttons == {"clutch"}


def test_a_pedal_that_is_silent_or_lost_is_released(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.teleop.feed.RETRY", 0.05)
    foot = Foot()
    with Both(Still(), foot) as both:
        both.wait()
        for fate in ("silent", "lost"):
            foot.feed(event(1, A, 1))
            both.soon_has("left", "clutch", "gripper")
            foot.fate = fate
            both.soon_has("left", "gripper")
            foot.fate = ""
            both.wait()
            for _ in range(20):  # what is still held, or was before it was opened again, does not count as pressed
                assert "clutch" not in both.poll().pressed["left"]
                time.sleep(0.002)
            foot.feed(event(1, A, 0))
            both.wait()
        foot.feed(event(1, A, 1))
        both.until(lambda news: "clutch" in news.pressed["left"])
        both.soon_has("left", "clutch", "gripper")


@pytest.mark.parametrize("fate", ["silent", "hangs", "lost", "untracked"])
def test_requests_beside_a_device_that_is_silent_or_lost_are_made_once(
    fate: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcs.teleop.feed.RETRY", 0.05)
    foot, leading = Foot(), ScriptedDevice(lambda t: held(LEVEL), is_waiting=True)

    def leads(news: News) -> bool:
        return news.reading is not None and news.reading.hands["right"].is_tracked

    with Both(leading, foot) as both:
        both.until(leads)
        both.wait()
        if fate == "untracked":
            leading.script = lambda t: HandReading(is_tracked=False)
        else:
            leading.fate = fate
        both.until(lambda news: not leads(news))
        foot.feed(event(1, C, 1) + event(1, C, 0))
        both.until(lambda _: bool(both.asked))
        leading.fate, leading.script = "", lambda t: held(LEVEL)
        both.until(leads)
        back = time.monotonic()
        both.until(lambda _: time.monotonic() > back + 0.1)
        assert both.asked == ["start"]


def test_a_press_beside_a_device_with_two_hands_is_one_request() -> None:
    foot, hands = Foot(), ("left", "right")
    leading = ScriptedDevice(lambda t: dict.fromkeys(hands, held(LEVEL)), hands=hands, is_waiting=True)
    asked = list[str]()
    with rcs.make("Free", robot="dual_fr3", binary_gripper=False, max_episode_steps=None) as env:
        operator = Operator(env, leading, beside=[foot])
        observation, info = env.reset(seed=0)
        operator.reset(observation, info)
        ((beside, is_clutch),) = operator._beside
        assert is_clutch
        end, more = time.monotonic() + 20, 20
        while operator.feed.readings < 2 or beside.readings < 2:
            assert time.monotonic() < end
            time.sleep(0.01)
        foot.feed(event(1, C, 1) + event(1, C, 0))
        while more:
            operator.wait(observation, info)
            asked += operator.events()
            more -= bool(asked)
            assert time.monotonic() < end
            time.sleep(0.01)
        foot.feed(event(1, 0x300, 1) + event(1, A, 7))
        while operator.left_out != ["left out: damaged 2"]:
            assert time.monotonic() < end, operator.left_out
            time.sleep(0.01)
        operator.close()
    assert asked == ["start"]


def test_a_device_that_does_not_open_leaves_the_pedal_closed() -> None:
    foot = Foot()
    with rcs.make("Free") as env:
        operator = Operator(env, Pedal("/dev/null/none"), beside=[foot])
        with pytest.raises(DeviceFault, match="no foot pedal"):
            operator.open()
    with pytest.raises(DeviceFault, match="closed"):
        foot.read()


def test_the_first_device_beside_a_leader_with_torque_is_its_clutch() -> None:
    leader = so101_leader("/dev/none", torque=True)
    with rcs.make("Free", robot="so101") as env:
        beside = Operator(env, leader, beside=[Still(), Still()])._beside
        assert [is_clutch for _, is_clutch in beside] == [True, False]
        leader = so101_leader("/dev/none")
        assert [is_clutch for _, is_clutch in Operator(env, leader, beside=[Still(), Foot()])._beside] == [False, True]
