"""Messages that the page in a headset sends: one of JSON per picture that the headset shows.

The axes of headsets are x to the right, y up, z to the back, as in OpenXR, WebXR and OpenVR.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike, NDArray

from rcs.teleop.device import Button, HandReading

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Seven = tuple[float, float, float, float, float, float, float]

MEANINGS: Mapping[str, Mapping[int, Button]] = {
    "left": {1: "clutch", 3: "reset", 4: "discard", 5: "failure"},
    "right": {1: "clutch", 3: "front", 4: "start", 5: "success"},
}
"""Meanings of buttons by their number in WebXR's `xr-standard` mapping: the squeeze, the stick, A or X, B or Y."""
PUSHED, LET_GO = -0.8, -0.6
"""Deflection of the left stick away from the person that presses the button `takeover`, and that releases it: a stick
at one of them gives the robot once."""
TO_FRONT_LEFT_UP = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotates a headset's axes into those of an input device: x to the front, y to the left, z up."""
FARTHEST = 100.0
"""Distance beyond which a pose is no pose [m]."""
UNIT = 0.01
"""Largest deviation of a quaternion's length from 1."""


class HandMessage(msgspec.Struct, forbid_unknown_fields=True):
    """A controller."""

    pose: Seven | None
    """Its grip in the headset's axes: translation [m], quaternion xyzw; None while it is not tracked."""
    trigger: Share
    """How far the trigger is pulled."""
    buttons: Annotated[int, Meta(ge=0, lt=1 << 16)]
    """Bits of the buttons that are held."""
    stick: Annotated[float, Meta(ge=-1.0, le=1.0)]
    """Deflection of the stick to the person."""


class FrameMessage(msgspec.Struct, forbid_unknown_fields=True):
    """Both controllers at one time."""

    number: Annotated[int, Meta(ge=0)]
    """Number of the message, from 0 on."""
    time: Annotated[float, Meta(ge=0.0, le=1e12)]
    """Time of the page [ms]."""
    round_trip: Annotated[float, Meta(ge=0.0, le=1e5)]
    """Shortest time of a message there and back so far [ms]; 0 if unknown."""
    hands: dict[str, HandMessage]
    """Controllers by hand."""


_decoder = msgspec.json.Decoder(FrameMessage)


def decode(data: Any) -> FrameMessage | None:
    """Return a message; None if it is none."""
    try:
        return _decoder.decode(data)
    except (msgspec.MsgspecError, UnicodeError, RecursionError, TypeError):
        return None


def hand_of(name: str, message: HandMessage | None, *, was_pushed: bool = False) -> HandReading:
    """Return the reading of a hand.

    Args:
        name: `left` or `right`.
        message: Message of the page about it; None for nothing.
        was_pushed: Whether the left stick was pushed away before.
    """
    if message is None:
        return HandReading(is_tracked=False, is_there=False)
    buttons: set[Button] = {meaning for bit, meaning in MEANINGS[name].items() if message.buttons >> bit & 1}
    if name == "left" and message.stick < (LET_GO if was_pushed else PUSHED):
        buttons.add("takeover")
    pose = None if message.pose is None else from_headset(np.array(message.pose))
    return HandReading(
        pose=pose, opening=1.0 - message.trigger, buttons=frozenset(buttons), is_tracked=pose is not None
    )


def from_headset(pose: ArrayLike) -> NDArray[np.float64]:
    """Return a pose of a headset in the axes of an input device; NaN if it is no pose, which the feed leaves out.

    The hand's own axes change likewise: x is where it points.

    Args:
        pose: Translation [m] and quaternion xyzw, (7,).
    """
    given = np.asarray(pose, np.float64)
    length = float(np.linalg.norm(given[3:]))
    if not np.isfinite(given).all() or np.abs(given[:3]).max() > FARTHEST or abs(length - 1.0) > UNIT:
        return np.full(7, np.nan)
    turned = given[3:] / length
    return np.array([*(TO_FRONT_LEFT_UP @ given[:3]), *(TO_FRONT_LEFT_UP @ turned[:3]), turned[3]])
