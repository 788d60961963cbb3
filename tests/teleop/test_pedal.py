"""Foot pedals and keyboards of the robot's own, through events of the kernel."""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import rcs
from rcs.errors import DeviceFault
from rcs.teleop.device import HandReading, InputDevice, Reading
from rcs.teleop.feed import Feed, News
from rcs.teleop.input_events import InputEvents
from rcs.teleop.operator import Operator
from rcs.teleop.pedal import Pedal, WithButtons
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

    valid_for = 0.07
    hands = ("left", "right")
    is_open = False

    def open(self) -> None:
        self.is_open = True

    def read(self) -> Reading:
        hand = HandReading(twist=np.zeros(6), buttons=frozenset({"clutch", "gripper"}))
        return Reading(time=1.0, hands={"left": hand, "right": hand})

    def close(self) -> None:
        self.is_open = False


class Foot(Pedal):
    """A pedal without a file: its keys are what the test gives."""

    fate = ""

    def open(self) -> None:
        keys = InputEvents("", "")

        def wait(seconds: float) -> None:
            time.sleep(0.002)
            if self.fate == "lost":
                raise DeviceFault("the cable is out")
            keys.time = keys.time if self.fate else time.monotonic()

        keys.wait = wait  # type: ignore[method-assign]
        self._opened.put(keys)

    def feed(self, data: bytes) -> None:
        with self._opened as keys:
            keys.feed(data)


def soon_has(device: InputDevice, hand: str, *buttons: str) -> None:
    """Wait until a hand has these buttons and no others."""
    end = time.monotonic() + 20
    while (found := device.read()) is None or found.hands[hand].buttons != set(buttons):
        assert time.monotonic() < end, found
        time.sleep(0.002)


def soon_asks(device: InputDevice, *requests: str) -> None:
    """Wait until these requests are made, and no others."""
    end, found = time.monotonic() + 20, list[str]()
    while found != list(requests):
        found += device.requests()
        assert time.monotonic() < end, found
        time.sleep(0.002)


def wait_for_news(device: WithButtons) -> None:
    """Wait until the second device was read again."""
    end, before = time.monotonic() + 20, device._second.readings
    while device._second.readings < before + 3:
        assert time.monotonic() < end
        time.sleep(0.002)


def test_beside_a_pedal_the_devices_own_clutch_does_not_count() -> None:
    still, foot = Still(), Foot()
    with WithButtons(still, foot) as device:
        device.open()
        assert (device.valid_for, device.hands, device.has_clutch) == (0.07, ("left", "right"), True)
        soon_has(device, "left", "gripper")
        wait_for_news(device)
        foot.feed(event(1, A, 1))
        soon_has(device, "left", "clutch", "gripper")
        foot.feed(event(1, A, 0))
        soon_has(device, "right", "gripper")
        foot.feed(event(1, C, 1) + event(1, C, 0))  # too short to be seen held
        soon_asks(device, "start")
        foot.feed(event(1, A, 1) + event(1, A, 0))
        soon_has(device, "right", "clutch", "gripper")
        soon_has(device, "right", "gripper")
    assert not still.is_open


def test_beside_any_other_device_only_its_clutch_does_not_count() -> None:
    still, foot = Still(), Foot()
    with WithButtons(still, foot, clutch=False) as device:
        device.open()
        wait_for_news(device)
        foot.feed(event(1, A, 1) + event(1, C, 1))
        soon_has(device, "left", "clutch", "gripper")
        soon_asks(device, "start")


def test_every_key_of_a_pedal_with_one_switch_may_be_the_clutch() -> None:
    with Foot("clutch") as foot:
        foot.open()
        foot.feed(event(1, B, 1))
        soon_has(foot, "right", "clutch")


def test_two_devices_have_the_button_takeover_if_one_has() -> None:
    leading = Still()
    assert WithButtons(leading, Foot()).has_takeover
    leading.has_takeover = False
    assert not WithButtons(leading, Foot()).has_takeover
    assert WithButtons(leading, Still()).has_takeover


def test_what_of_the_second_device_was_left_out_is_counted_too() -> None:
    foot = Foot()
    with WithButtons(Still(), foot) as device:
        device.open()
        wait_for_news(device)
        foot.feed(event(1, 0x300, 1) + event(1, A, 7))
        wait_for_news(device)
        reading = device.read()
        assert reading is not None and reading.counts == {"damaged": 2}


def test_a_pedal_that_is_silent_or_lost_is_released() -> None:
    foot = Foot()
    with WithButtons(Still(), foot) as device:
        device.open()
        wait_for_news(device)
        for fate in ("silent", "lost"):
            foot.feed(event(1, A, 1))
            soon_has(device, "left", "clutch", "gripper")
            foot.fate = fate
            soon_has(device, "left", "gripper")
            foot.fate = ""
            wait_for_news(device)
            for _ in range(20):  # what is still held, or was before it was opened again, does not count
                reading = device.read()
                assert reading is not None and reading.hands["left"].buttons == {"gripper"}
                time.sleep(0.002)
            foot.feed(event(1, A, 0))
            wait_for_news(device)
        foot.feed(event(1, A, 1))
        soon_has(device, "left", "clutch", "gripper")


@pytest.mark.parametrize("fate", ["silent", "hangs", "lost", "untracked"])
def test_requests_beside_a_device_that_is_silent_or_lost_are_made_once(
    fate: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcs.teleop.feed.RETRY", 0.05)
    foot, leading = Foot(), ScriptedDevice(lambda t: held(LEVEL), is_waiting=True)
    asked: list[str] = []

    def wait_until(is_true: Callable[[News], bool]) -> None:
        end = time.monotonic() + 20
        while True:
            news = feed.poll()
            asked.extend([*news.requests, *(one for pressed in news.pressed.values() for one in pressed)])
            if is_true(news):
                return
            assert time.monotonic() < end, (news, asked)
            time.sleep(0.002)

    def leads(news: News) -> bool:
        return news.reading is not None and news.reading.hands["right"].is_tracked

    with Feed(WithButtons(leading, foot)) as feed:
        feed.open()
        wait_until(leads)
        if fate == "untracked":
            leading.script = lambda t: HandReading(is_tracked=False)
        else:
            leading.fate = fate
        wait_until(lambda news: not leads(news))
        foot.feed(event(1, C, 1) + event(1, C, 0))
        wait_until(lambda news: bool(asked))
        leading.fate, leading.script = "", lambda t: held(LEVEL)
        wait_until(leads)
        back = time.monotonic()
        wait_until(lambda news: time.monotonic() > back + 0.1)
    assert asked == ["start"]


def test_a_press_beside_a_device_with_two_hands_is_one_request() -> None:
    foot, hands = Foot(), ("left", "right")
    leading = ScriptedDevice(lambda t: dict.fromkeys(hands, held(LEVEL)), hands=hands, is_waiting=True)
    device, asked = WithButtons(leading, foot), list[str]()
    with rcs.make("Free", robot="dual_fr3", binary_gripper=False, max_episode_steps=None) as env:
        operator = Operator(env, device)
        observation, info = env.reset(seed=0)
        operator.reset(observation, info)
        wait_for_news(device)
        end, more = time.monotonic() + 20, 20
        while operator.feed.readings < 2:
            assert time.monotonic() < end
            time.sleep(0.01)
        foot.feed(event(1, C, 1) + event(1, C, 0))
        while more:
            operator.wait(observation, info)
            asked += operator.events()
            more -= bool(asked)
            assert time.monotonic() < end
            time.sleep(0.01)
        operator.close()
    assert asked == ["start"]


def test_a_device_that_does_not_open_leaves_the_pedal_closed() -> None:
    foot = Foot()
    device = WithButtons(Pedal("/dev/null/none"), foot)
    with pytest.raises(DeviceFault, match="no foot pedal"):
        device.open()
    with pytest.raises(DeviceFault, match="closed"):
        foot.read()
