"""A gamepad whose sticks command velocities, through SDL, which knows the buttons of most."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.spaces import Observation
from rcs.errors import DeviceFault, InvalidSetup
from rcs.extras import package_of
from rcs.teleop.device import Button, Connected, HandReading, Motion, Reading
from rcs.teleop.device_file import one_of, udev_rule
from rcs.teleop.input_events import keys_of

PERIOD = 0.008
"""Time between two readings [s]; most gamepads report every 4 to 8 ms."""
SPEED = 0.2
"""Velocity at full deflection [m/s]."""
TURN_SPEED = 1.0
"""Rotational velocity at full deflection [rad/s]."""
REST = 0.1
"""Share of a full deflection within which a stick may rest."""
FULL = 32767
BUTTONS = 0xFFFFFFFF << 0x120
"""Bits of the buttons of joysticks and gamepads among a device's keys (linux/input-event-codes.h)."""
MATCH = 'KERNEL=="event*", ENV{ID_INPUT_JOYSTICK}=="1"'
LEFT_X, LEFT_Y, RIGHT_X, RIGHT_Y, RIGHT_TRIGGER = 0, 1, 2, 3, 5
"""Axes of SDL's game controllers; y points to the person."""
TURNS = 10
"""Button that has the left stick turn: the right shoulder."""
MEANINGS: dict[int, Button] = {
    9: "clutch", 0: "start", 1: "success", 2: "discard", 3: "failure", 4: "reset", 6: "takeover", 5: "stop",
}  # fmt: skip
"""Meanings by button of SDL's game controllers: left shoulder; A, B, X, Y; back, start, guide."""
RUMBLE: Mapping[str, tuple[float, int]] = {"engaged": (0.3, 60), "held": (0.8, 200)}
"""Strength, and time [ms], by the state that a hand gets into."""
SETTINGS = {
    "PYGAME_HIDE_SUPPORT_PROMPT": "1",
    "SDL_NO_SIGNAL_HANDLERS": "1",
    "SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS": "1",
}
"""Settings of SDL: no advertisement, signals are the program's, and no window is needed."""


class Pad:
    """An open gamepad of SDL."""

    def __init__(self, address: str | None) -> None:
        """Open it; arguments and faults as of `Gamepad`."""
        os.environ.update(SETTINGS)
        os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # SDL gives no news without one
        self._pygame = package_of("teleop", "pygame", "A gamepad needs pygame-ce, which brings")
        controllers: Any = package_of("teleop", "pygame._sdl2.controller")
        self._pygame.display.init()
        controllers.init()
        self._pygame.event.pump()
        sticks = range(self._pygame.joystick.get_count())
        if address is None:
            found = {str(at): controllers.Controller(at).name for at in sticks if controllers.is_controller(at)}
            missing = _why_none([self._pygame.joystick.Joystick(at).get_name() for at in sticks])
            address = one_of("gamepad", found, missing)
        if int(address) not in sticks or not controllers.is_controller(int(address)):
            raise DeviceFault(f"There is no gamepad {address}; {len(sticks)} are connected, counted from 0.")
        self._pad: Any = controllers.Controller(int(address))

    def state(self) -> tuple[NDArray[np.float64], frozenset[int]]:
        """Return the axes, 1 for full, and the numbers of the buttons that are held."""
        try:
            self._pygame.event.pump()
            self._pygame.event.clear()
            is_there = self._pad.attached()
            axes = np.array([self._pad.get_axis(at) for at in range(6)]) / FULL
            buttons = frozenset(at for at in range(15) if self._pad.get_button(at))
        except self._pygame.error as err:  # the program ends, or another part of it ended SDL
            raise DeviceFault(f"The gamepad is gone: {err}.") from err
        if not is_there:
            raise DeviceFault("The gamepad is gone; plug it in again, and start anew.")
        return axes, buttons

    def rumble(self, strength: float, duration: int) -> None:
        """Rumble, where it can."""
        self._pad.rumble(strength, strength, duration)

    def close(self) -> None:
        """Let go of the gamepad."""
        self._pad.quit()


class Gamepad(Connected[Pad]):
    """Two sticks; the left shoulder is the clutch, and the right trigger closes the gripper."""

    what = "gamepad"
    valid_for = 0.08
    motion: Motion = ("twist", 6)

    def __init__(self, address: str | None = None) -> None:
        """Remember which.

        Args:
            address: Number of the gamepad as SDL counts them, from 0 on; None for the only one.

        Raises:
            InvalidSetup: The address is no number.
        """
        if address is not None and not address.isdigit():
            raise InvalidSetup(f"The gamepad's address is {address!r}; valid is none, or a number such as 0.")
        super().__init__()
        self._address = address
        self._due = 0.0
        self._state, self._rumble = "", ""

    def connect(self) -> Pad:
        """Open it; faults as in `InputDevice.open`."""
        return Pad(self._address)

    def measure(self, connection: Pad) -> Reading:
        """Return what is held, 125 times a second at most."""
        time.sleep(max(self._due - time.monotonic(), 0.0))
        self._due = time.monotonic() + PERIOD
        axes, buttons = connection.state()
        rumble, self._rumble = self._rumble, ""
        if rumble in RUMBLE:
            strength, duration = RUMBLE[rumble]
            connection.rumble(strength, duration)
        return Reading(time=time.monotonic(), hands={"right": hand_of(axes, buttons)})

    def feedback(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Let the person feel that the robot follows, or that it is held."""
        state = dict(info.get("operator", {})).get("right", "")
        if state != self._state:
            self._state = self._rumble = state


def hand_of(axes: NDArray[np.float64], buttons: frozenset[int]) -> HandReading:
    """Return the hand of a state.

    Args:
        axes: Deflections of SDL's axes, 1 for full, (6,).
        buttons: Numbers of the buttons that are held.
    """
    left = _stick(axes[LEFT_X], axes[LEFT_Y])
    right = _stick(axes[RIGHT_X], axes[RIGHT_Y])
    turn = np.array([left[0], -left[1], -right[0]]) if TURNS in buttons else np.array([0.0, 0.0, -right[0]])
    move = np.array([0.0 if TURNS in buttons else -left[1], 0.0 if TURNS in buttons else -left[0], -right[1]])
    return HandReading(
        twist=np.concatenate([SPEED * move, TURN_SPEED * turn]),
        opening=float(np.clip(1.0 - axes[RIGHT_TRIGGER], 0.0, 1.0)),
        buttons=frozenset(MEANINGS[at] for at in buttons if at in MEANINGS),
    )


def _stick(x: float, y: float) -> NDArray[np.float64]:
    """Return a stick's deflection without the part in which it may rest, at most 1."""
    length = float(np.hypot(x, y))
    if length <= REST:
        return np.zeros(2)
    return np.array([x, y]) / length * min((length - REST) / (1.0 - REST), 1.0)


def _why_none(others: list[str]) -> str:
    if others:
        names = ", ".join(others)
        return f"SDL does not know the buttons of {names}; set SDL_GAMECONTROLLERCONFIG to its line in SDL's list."
    hidden = [
        str(path)
        for path in sorted(Path("/dev/input").glob("event*"))
        if keys_of(path.name) & BUTTONS and not os.access(path, os.R_OK)
    ]
    if hidden:
        return f"You may not read {', '.join(hidden)}. Allow it: {udev_rule(MATCH, 'gamepad')}"
    return "Plug it in, or pair it."
