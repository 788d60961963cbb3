"""Readings: what makes no sense is left out and counted, presses are not lost, and a lost device comes back."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rcs.errors import DeviceFault, InvalidSetup, UnknownName
from rcs.teleop import Feed, HandReading, InputDevice, Operator, Reading
from rcs.teleop import operator as operators
from tests.teleop.scripted_device import ScriptedDevice, at, held

GOOD = held(at(0.1, 0.2, 1.0))


class Listed(InputDevice):
    """Gives readings from a list, at times of its own."""

    def __init__(self, readings: list[Reading]) -> None:
        self.readings, self.now = readings, 0.0

    def open(self) -> None: ...

    def read(self) -> Reading | None:
        if not self.readings:
            return None
        reading = self.readings.pop(0)
        self.now = max(self.now, reading.time if np.isfinite(reading.time) else self.now)
        return reading

    def close(self) -> None: ...


def fed(*readings: Reading, at_time: float | None = None) -> tuple[Feed, Any]:
    device = Listed(list(readings))
    feed = Feed(device, clock=lambda: device.now if at_time is None else at_time, has_thread=False)
    feed.open()
    news = [feed.poll() for _ in readings]
    return feed, news


def reading(when: float, hand: HandReading = GOOD, **others: Any) -> Reading:
    return Reading(time=when, hands={"right": hand}, **others)


@pytest.mark.parametrize(
    ("flaw", "bad"),
    [
        ("not finite", reading(0.02, held(at(np.nan, 0.0, 0.0)))),
        ("not finite", reading(0.02, held(at(np.inf, 0.0, 0.0)))),
        ("not finite", reading(0.02, held(np.zeros(6)))),
        ("not finite", reading(0.02, held(None, twist=np.full(6, np.nan)))),
        ("not finite", reading(0.02, held(None, joints=np.array([np.nan])))),
        ("no rotation", reading(0.02, held(at(0.0, 0.0, 0.0, rotation=(0.0, 0.0, 0.0, 0.5))))),
        ("no rotation", reading(0.02, held(np.zeros(7)))),
        ("wrong opening", reading(0.02, held(GOOD.pose, opening=1.5))),
        ("wrong opening", reading(0.02, held(GOOD.pose, opening=float("nan")))),
        ("unknown button", reading(0.02, replace(GOOD, buttons=frozenset({"fire"})))),  # pyright: ignore[reportArgumentType]
        ("unknown hand", Reading(time=0.02, hands={"third": GOOD})),
        ("time runs backwards", reading(-0.01)),
        ("time runs backwards", reading(0.0)),
        ("wrong time", reading(float("nan"))),
        ("repeated", reading(0.02, device_time=7.0)),
    ],
)
def test_a_reading_that_makes_no_sense_is_left_out_and_counted(flaw: str, bad: Reading) -> None:
    feed, news = fed(reading(0.0, device_time=7.0), bad)
    assert news[1].reading is not None
    assert news[1].reading.time == 0.0
    assert feed.counts == {flaw: 1}
    assert feed.readings == 1


def test_nothing_but_bad_readings_is_stale_after_a_while() -> None:
    bad = [reading(0.01 * i, held(at(np.nan, 0.0, 0.0))) for i in range(1, 30)]
    feed, news = fed(reading(0.0), *bad)
    assert news[5].reading is not None
    assert news[-1].reading is None
    assert "silent for 0.2" in news[-1].why
    assert feed.counts == {"not finite": 29}


def test_a_reading_from_the_future_is_left_out() -> None:
    feed, news = fed(reading(5.0), at_time=1.0)
    assert feed.counts == {"wrong time": 1}
    assert news[0].reading is None


def test_a_press_between_two_questions_is_not_lost() -> None:
    device = Listed([reading(0.0), reading(0.01, held(GOOD.pose, "start", "clutch")), reading(0.02)])
    feed = Feed(device, clock=lambda: device.now, has_thread=False)
    feed.open()
    for _ in range(2):
        feed._take(device.read())  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType, reportPrivateUsage]
    assert feed.poll().pressed == {"right": ["clutch", "start"]}
    assert feed.poll().pressed == {}


def test_requests_are_told_also_when_the_device_is_silent_or_the_hand_lost_right_after() -> None:
    for last in (None, reading(0.02, HandReading(is_tracked=False))):
        device = Listed([reading(0.0), reading(0.01, held(GOOD.pose, "discard", "clutch")), *([last] if last else [])])
        feed = Feed(device, clock=lambda device=device: device.now, has_thread=False)
        feed.open()
        while device.readings:
            feed._take(device.read())  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType, reportPrivateUsage]
        device.now += 0.0 if last else 1.0
        news = feed.poll()
        assert news.pressed["right"] == ["discard"] if last else "discard" in news.pressed["right"]
        assert (news.reading is None) is (last is None)


def test_a_request_that_shows_first_after_a_silence_is_not_lost_and_what_a_hand_holds_was_not_pressed() -> None:
    _, news = fed(reading(0.0, held(GOOD.pose, "failure")), reading(1.0, held(GOOD.pose, "failure", "stop", "clutch")))
    assert news[1].pressed == {"right": ["stop"]}


def test_a_hand_that_is_out_of_sight_makes_requests_and_one_that_was_not_there_makes_none() -> None:
    unseen = HandReading(is_tracked=False)
    _, news = fed(reading(0.0, unseen), reading(0.01, replace(unseen, buttons=frozenset({"takeover", "clutch"}))))
    assert news[1].pressed == {"right": ["takeover"]}
    _, news = fed(reading(0.0, replace(unseen, is_there=False)), reading(0.01, held(GOOD.pose, "start")))
    assert not news[1].pressed.get("right")


@pytest.mark.parametrize(("way", "leaps"), [(0.45, False), (0.55, True)])
def test_a_leader_whose_joint_leaps_breaks(way: float, leaps: bool) -> None:
    _, news = fed(
        reading(0.0, held(None, joints=np.zeros(3))), reading(0.01, held(None, joints=np.array([0.0, -way, 0.0])))
    )
    assert ("right" in news[1].broken) is leaps


class Hanging(InputDevice):
    """Hangs in the first `read` or the second `open`, until that is let go."""

    def __init__(self, where: str) -> None:
        self.where, self.opened, self.closed, self.reads = where, 0, 0, 0
        self.go, self.is_in = threading.Event(), threading.Event()

    def open(self) -> None:
        self.opened += 1
        if self.where == "open" and self.opened == 2:
            self.is_in.set()
            self.go.wait(20)

    def read(self) -> Reading | None:
        self.reads += 1
        if self.where == "open":
            raise DeviceFault("the cable is out")
        if self.reads == 1:
            self.is_in.set()
            self.go.wait(20)
            return reading(time.monotonic(), held(GOOD.pose, "clutch"))
        time.sleep(0.01)
        return None

    def close(self) -> None:
        self.closed += 1


def test_a_thread_that_was_left_behind_reads_no_more_when_the_device_is_opened_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcs.teleop.feed.PATIENCE", 0.05)
    device = Hanging("read")
    feed = Feed(device)
    feed.open()
    assert device.is_in.wait(10)
    behind = feed._thread
    assert behind is not None
    feed.close()
    feed.open()
    device.go.set()
    behind.join(10)
    assert not behind.is_alive()
    assert feed.readings == 0
    feed.close()


def test_a_device_that_is_opened_while_it_is_closed_is_closed_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.teleop.feed.RETRY", 0.01)
    monkeypatch.setattr("rcs.teleop.feed.PATIENCE", 0.05)
    device = Hanging("open")
    feed = Feed(device)
    feed.open()
    assert device.is_in.wait(10)
    behind = feed._thread
    assert behind is not None
    feed.close()
    closed = device.closed
    device.go.set()
    behind.join(10)
    assert not behind.is_alive()
    assert device.closed == closed + 1


def test_a_button_that_is_held_when_the_device_comes_back_was_not_pressed() -> None:
    lost = HandReading(is_tracked=False)
    _, news = fed(
        reading(0.0, held(GOOD.pose, "clutch")), reading(0.01, lost), reading(0.02, held(GOOD.pose, "clutch"))
    )
    assert [own.pressed.get("right", []) for own in news] == [[], [], []]
    assert news[1].broken == {"right": "not tracked"}


@pytest.mark.parametrize(("way", "leaps"), [(0.29, False), (0.31, True)])
def test_a_hand_that_leaps_breaks(way: float, leaps: bool) -> None:
    _, news = fed(reading(0.0), reading(0.01, held(at(0.1 + way, 0.2, 1.0))))
    assert ("right" in news[1].broken) is leaps


def wait_until(is_true: Callable[[], bool]) -> None:
    end = time.monotonic() + 10.0
    while not is_true():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_lost_device_is_told_and_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.teleop.feed.RETRY", 0.05)
    device = ScriptedDevice(lambda t: GOOD, is_waiting=True)
    with Feed(device) as feed:
        feed.open()
        wait_until(lambda: feed.poll().reading is not None)
        device.fate = "lost"
        wait_until(lambda: feed.poll().reading is None)
        assert feed.poll().why == "DeviceFault: the cable is out"
        wait_until(lambda: feed.counts["lost"] > 1)
        device.fate = ""
        wait_until(lambda: feed.poll().reading is not None)
    assert not feed.is_open
    feed.close()


def test_a_device_that_is_not_there_is_an_error_before_anything_moves() -> None:
    device = ScriptedDevice(lambda t: GOOD)
    device.fate = "lost"
    feed = Feed(device)
    with pytest.raises(DeviceFault, match="the cable is out"):
        feed.open()
    assert not feed.is_open


def test_devices_are_found_by_name_with_their_address(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str | None] = []

    def make(address: str | None) -> InputDevice:
        made.append(address)
        return ScriptedDevice(lambda t: GOOD)

    found = {"puck": make, "wrong": lambda _: 7, "my.own:Puck": make}
    monkeypatch.setattr(operators.lookup, "find", lambda kind, name: found[name])
    monkeypatch.setattr(operators.lookup, "names", lambda kind: ["puck", "wrong"])
    for given in ("puck:/dev/hidraw0:1", "puck", "my.own:Puck", "my.own:Puck:7:8"):
        operators.device_of(given)
    assert made == ["/dev/hidraw0:1", None, None, "7:8"]
    with pytest.raises(InvalidSetup, match="valid is an InputDevice"):
        operators.device_of("wrong")


def test_an_unknown_device_lists_the_known_ones() -> None:
    import rcs

    with pytest.raises(UnknownName, match="no input device named"):
        Operator(rcs.make("Free"), "joistick")


@pytest.mark.slow
def test_a_hundred_thousand_random_readings_move_nothing_and_end_nothing() -> None:
    random = np.random.default_rng(0)
    strange = [np.nan, np.inf, -np.inf, 1e308, -1.0, 0.0, 1.0]
    device = Listed([])
    feed = Feed(device, clock=lambda: device.now, has_thread=False)
    feed.open()
    taken = 0
    for i in range(100_000):
        numbers = random.choice(strange, size=random.integers(0, 9))
        kind = ("pose", "twist", "joints")[random.integers(3)]
        opening = None if random.random() < 0.5 else float(random.choice(strange))
        hand = HandReading(
            **{kind: numbers}, opening=opening, buttons=frozenset({"clutch"}), is_tracked=bool(random.random() < 0.9)
        )
        when = 1e-3 * i if random.random() < 0.8 else float(random.choice(strange))
        device.readings.append(Reading(time=when, hands={str(random.choice(["right", "left"])): hand}))
        news = feed.poll()
        if news.reading is not None and news.reading.time == when and (found := news.reading.hands.get("right")):
            taken += 1
            given = next((own for own in (found.pose, found.twist, found.joints) if own is not None), np.zeros(0))
            assert not found.is_tracked or np.isfinite(given).all()
            assert not found.is_tracked or found.pose is None or abs(np.linalg.norm(found.pose[3:]) - 1.0) < 1e-3
    assert 0 < taken < 20_000
    assert sum(feed.counts.values()) + feed.readings == 100_000
