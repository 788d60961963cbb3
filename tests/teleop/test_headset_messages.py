"""Messages that a page in a headset sends, and the axes that it is in."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from rcs.spatial import compose, inverse
from rcs.teleop.device import Reading
from rcs.teleop.feed import flaw_of
from rcs.teleop.headset_messages import decode, from_headset, hand_of

HALF = np.sqrt(0.5)


def message(**changes: Any) -> bytes:
    hand = {"pose": [0, 0, 0, 0, 0, 0, 1], "trigger": 0.25, "buttons": 0, "stick": 0}
    return json.dumps({"number": 0, "time": 1.5, "round_trip": 0, "hands": {"right": {**hand, **changes}}}).encode()


def test_right_up_and_back_become_right_up_and_back_of_the_level_frame() -> None:
    for given, wanted in (((1, 0, 0), (0, -1, 0)), ((0, 1, 0), (0, 0, 1)), ((0, 0, 1), (-1, 0, 0))):
        assert from_headset([*given, 0, 0, 0, 1]).tolist() == [*wanted, 0, 0, 0, 1]


def test_turns_keep_their_axis_and_sense() -> None:
    about_up = from_headset([0, 0, 0, 0, HALF, 0, HALF])
    assert about_up == pytest.approx([0, 0, 0, 0, 0, HALF, HALF])
    pointing = compose(about_up, [1, 0, 0, 0, 0, 0, 1])  # a hand that turned to the left points to the left
    assert pointing[:3] == pytest.approx([0, 1, 0])


def test_the_change_of_axes_keeps_relative_poses() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        a, b = (np.array([*rng.normal(size=3), *(q / np.linalg.norm(q))]) for q in rng.normal(size=(2, 4)))
        here, there = from_headset(a), from_headset(b)
        same = from_headset(compose(inverse(a), b))
        found = compose(inverse(here), there)
        assert np.allclose(found[:3], same[:3])
        assert abs(found[3:] @ same[3:]) == pytest.approx(1.0)


@pytest.mark.parametrize("pose", [[0] * 7, [np.nan, 0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0, 0, 2], [1e6, 0, 0, 0, 0, 0, 1]])
def test_what_is_no_pose_is_left_out_and_counted_not_taken_for_a_hand_that_is_lost(pose: list[float]) -> None:
    assert np.isnan(from_headset(pose)).all()
    if np.isfinite(pose).all():  # JSON has no other numbers
        hand = hand_of("right", decode(message(pose=pose)).hands["right"])
        assert flaw_of(Reading(time=0.0, hands={"right": hand}), ["right"], None, 0.0) == "not finite"


def test_a_hand_has_its_buttons_and_the_opening_of_its_trigger() -> None:
    hand = hand_of("right", decode(message(buttons=1 << 1 | 1 << 5 | 1 << 9)).hands["right"])
    assert (hand.buttons, hand.opening, hand.is_tracked) == ({"clutch", "success"}, 0.75, True)
    left = hand_of("left", decode(message(stick=-0.9)).hands["right"])
    assert left.buttons == {"takeover"}
    between = decode(message(stick=-0.7)).hands["right"]
    assert hand_of("left", between).buttons == frozenset()
    assert hand_of("left", between, was_pushed=True).buttons == {"takeover"}
    assert not hand_of("left", None).is_tracked
    assert not hand_of("left", None).is_there
    unseen = hand_of("left", decode(message(pose=None)).hands["right"])
    assert (unseen.is_tracked, unseen.is_there) == (False, True)


@pytest.mark.parametrize(
    "sent",
    [
        b"", b"{}", b"[]", b"\xff\xfe", b"nonsense", message(trigger=1.5), message(trigger="0"), message(pose=[1, 2]),
        message(buttons=-1), message(buttons=1 << 20), message(extra=1), message(pose=[0] * 6 + [None]),
        message().replace(b"1.5", b"-1"), message().replace(b"0.25", b"NaN"), b"[" * 100_000, message(stick=-3),
    ],
)  # fmt: skip
def test_what_is_no_message_is_none(sent: bytes) -> None:
    assert decode(sent) is None
