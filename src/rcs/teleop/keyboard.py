"""A keyboard that commands velocities: the terminal's, or one that is for the robot alone."""

from __future__ import annotations

import numpy as np

from rcs.errors import InvalidSetup
from rcs.teleop.device import Button, Connected, HandReading, Motion, Reading
from rcs.teleop.input_events import InputEvents, Keys
from rcs.teleop.terminal import Terminal

PERIOD = 0.02
"""Longest time between two readings [s]."""
MOTIONS = {
    "w": (0, 1), "s": (0, -1), "a": (1, 1), "d": (1, -1), "r": (2, 1), "f": (2, -1),
    "o": (3, 1), "u": (3, -1), "i": (4, 1), "k": (4, -1), "j": (5, 1), "l": (5, -1),
    "up": (0, 1), "down": (0, -1), "left": (1, 1), "right": (1, -1),
}  # fmt: skip
"""Axis and sign by key: to the front, left and up, then about these axes."""
MEANINGS: dict[str, Button] = {
    "space": "gripper", "enter": "start", "y": "success", "n": "failure", "backspace": "discard", "b": "reset",
    "p": "takeover", "escape": "stop",
}  # fmt: skip
FASTER, SLOWER = ("=", "+"), "-"
STEP = 1.5
"""Factor of one press of `FASTER` or `SLOWER`."""
SPEED, SLOWEST, FASTEST = 0.1, 0.01, 0.25
"""Velocity at first, and its bounds [m/s]."""
TURN = 5.0
"""Rotational velocity per velocity [rad/m]."""
KNOWN = frozenset({*MOTIONS, *MEANINGS, *FASTER, SLOWER})
TOGETHER = 6
"""Most keys of motion at once; more mean something lies on the keyboard."""


class Keyboard(Connected[Keys]):
    """Keys command the velocity of one hand as long as they are held; `space` opens and closes the gripper."""

    what = "keyboard"
    valid_for = 0.15
    motion: Motion = ("twist", 6)
    instructions = (
        "w s, a d, r f move; o u, i k, j l turn; space: gripper; - =: speed; enter: take begins or ends; y n: success, "
        "failure; backspace: discard; b: next episode; p: take over; escape: stop"
    )

    def __init__(self, address: str | None = None, *, keys: Keys | None = None) -> None:
        """Remember which keyboard.

        Args:
            address: Path of a keyboard that is for the robot alone, such as `/dev/input/event5`; None for the
                terminal's.
            keys: Another keyboard, in place of the address.

        Raises:
            InvalidSetup: The address is no path.
        """
        if address is not None and not address.startswith("/"):
            raise InvalidSetup(f"The keyboard's address is {address!r}; valid is none, or a path of /dev/input/.")
        super().__init__()
        self._address, self._given = address, keys
        self._last, self._unknown = 0.0, 0
        self.speed = SPEED
        """Velocity while a key is held [m/s]."""

    def connect(self) -> Keys:
        """Open it; faults as in `InputDevice.open`."""
        keys = self._given
        if keys is None:
            keys = Terminal(MEANINGS) if self._address is None else InputEvents(self._address, "keyboard")
        keys.open()
        self.speed, self._unknown = SPEED, 0
        return keys

    def measure(self, connection: Keys) -> Reading | None:
        """Return what is held, at each change and about every 0.03 s; None while the terminal does not answer."""
        connection.wait(PERIOD)
        if connection.time <= self._last:
            return None  # the terminal has not answered
        self._last = connection.time
        pressed, connection.pressed = connection.pressed, []
        self._unknown += len([key for key in pressed if key not in KNOWN])
        for key in pressed:
            step = STEP if key in FASTER else 1 / STEP if key == SLOWER else 1.0
            self.speed = min(max(self.speed * step, SLOWEST), FASTEST)
        held = connection.held.union(pressed)  # a short press is in one reading at least
        moving = [MOTIONS[key] for key in held if key in MOTIONS]
        twist = np.zeros(6)
        if len(moving) <= TOGETHER:
            for axis, sign in moving:
                twist[axis] += sign * self.speed * (1.0 if axis < 3 else TURN)
        buttons: set[Button] = {MEANINGS[key] for key in held if key in MEANINGS}
        if twist.any():
            buttons.add("clutch")
        hand = HandReading(twist=twist, buttons=frozenset(buttons))
        counts = {"damaged": connection.damaged, "unknown key": self._unknown}
        return Reading(time=connection.time, hands={"right": hand}, counts=counts)
