"""Gamepads: their sticks and buttons, and SDL's own way to a virtual one."""

from __future__ import annotations

import ctypes
import glob
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.errors import DeviceFault, InvalidSetup
from rcs.teleop import gamepad
from rcs.teleop.device import HandReading
from rcs.teleop.gamepad import SPEED, TURN_SPEED, Gamepad, hand_of

A, B, LEFT_SHOULDER, RIGHT_SHOULDER = 0, 1, 9, 10


def hand(*buttons: int, **axes: float) -> HandReading:
    names = ("left_x", "left_y", "right_x", "right_y", "left_trigger", "right_trigger")
    return hand_of(np.array([axes.get(name, 0.0) for name in names]), frozenset(buttons))


def test_sticks_move_to_the_front_left_and_up() -> None:
    assert hand(left_y=-1.0).twist.tolist() == [SPEED, 0, 0, 0, 0, 0]
    assert hand(left_x=-1.0).twist.tolist() == [0, SPEED, 0, 0, 0, 0]
    assert hand(right_y=-1.0).twist.tolist() == [0, 0, SPEED, 0, 0, 0]
    assert hand(right_x=-1.0).twist.tolist() == [0, 0, 0, 0, 0, TURN_SPEED]


def test_with_the_right_shoulder_the_left_stick_turns() -> None:
    assert hand(RIGHT_SHOULDER, left_x=1.0).twist.tolist() == [0, 0, 0, TURN_SPEED, 0, 0]
    assert hand(RIGHT_SHOULDER, left_y=-1.0).twist.tolist() == [0, 0, 0, 0, TURN_SPEED, 0]


def test_sticks_rest_within_a_tenth_and_go_on_from_zero() -> None:
    assert not hand(left_x=0.07, left_y=-0.07, right_y=0.1).twist.any()
    assert np.abs(hand(left_x=0.1001).twist).max() < 1e-4
    for angle in np.linspace(0, 6, 20):  # a stick in a square housing is not faster along its diagonals
        twist = hand(left_x=1.2 * np.cos(angle), left_y=1.2 * np.sin(angle)).twist
        assert np.linalg.norm(twist[:3]) == pytest.approx(SPEED)


def test_buttons_and_the_trigger() -> None:
    reading = hand(A, LEFT_SHOULDER, 14, right_trigger=0.25)
    assert (reading.buttons, reading.opening) == ({"start", "clutch"}, 0.75)


def test_an_address_that_is_no_number_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="number"):
        Gamepad("xbox")


def test_only_gamepads_that_may_not_be_read_are_named_with_the_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = {"event3": 1 << 0x130, "event4": 1 << 30}  # BTN_SOUTH, and a keyboard
    monkeypatch.setattr(gamepad, "keys_of", keys.__getitem__)
    monkeypatch.setattr(Path, "glob", lambda own, pattern: [own / name for name in keys if Path(name).match(pattern)])
    monkeypatch.setattr(os, "access", lambda *_: False)
    words = gamepad._why_none([])
    assert "You may not read /dev/input/event3. Allow it" in words
    keys["event3"] = 0
    assert gamepad._why_none([]) == "Plug it in, or pair it."


class Virtual:
    """SDL's virtual joystick, reached in the library that pygame brings."""

    def __init__(self) -> None:
        pygame = pytest.importorskip("pygame", reason="pip install 'robot-control-stack[teleop]'")
        (path,) = glob.glob(str(Path(pygame.__file__).parents[1] / "pygame_ce.libs" / "libSDL2-2-*.so*"))
        self._sdl: Any = ctypes.CDLL(path)
        self._sdl.SDL_JoystickOpen.restype = ctypes.c_void_p
        self._sdl.SDL_JoystickSetVirtualAxis.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int16]
        self._sdl.SDL_JoystickSetVirtualButton.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_uint8]
        self._sdl.SDL_InitSubSystem(0x200)
        self._at = self._sdl.SDL_JoystickAttachVirtual(1, 6, 15, 0)
        assert self._at >= 0
        self._stick = self._sdl.SDL_JoystickOpen(self._at)
        self.axis(5, -32768)  # a trigger at rest

    def axis(self, at: int, value: int) -> None:
        assert self._sdl.SDL_JoystickSetVirtualAxis(self._stick, at, value) == 0

    def button(self, at: int, is_held: bool) -> None:
        assert self._sdl.SDL_JoystickSetVirtualButton(self._stick, at, is_held) == 0

    def detach(self) -> None:
        if self._at >= 0:
            self._sdl.SDL_JoystickDetachVirtual(self._at)
            self._at = -1


@pytest.fixture
def virtual(monkeypatch: pytest.MonkeyPatch) -> Iterator[Virtual]:
    for name in ("PYGAME_HIDE_SUPPORT_PROMPT", "SDL_NO_SIGNAL_HANDLERS"):
        monkeypatch.setenv(name, "1")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    device = Virtual()
    yield device
    device.detach()


def seen(device: Gamepad, is_so: Any) -> HandReading:
    end = time.monotonic() + 5
    while not is_so(hand := device.read().hands["right"]):
        assert time.monotonic() < end, hand
    return hand


@pytest.mark.extras
def test_a_gamepad_is_read_through_sdl(virtual: Virtual) -> None:
    with Gamepad() as device:
        device.open()
        before = seen(device, lambda one: not one.twist.any())
        assert before.buttons == frozenset()
        virtual.axis(1, -32768)
        virtual.axis(5, 32767)
        virtual.button(LEFT_SHOULDER, True)
        found = seen(device, lambda one: "clutch" in one.buttons)
        assert found.twist.tolist() == [SPEED, 0, 0, 0, 0, 0]
        assert found.opening == pytest.approx(0.0, abs=1e-3)
        device.feedback({}, {"operator": {"right": "engaged"}})
        virtual.button(LEFT_SHOULDER, False)
        virtual.axis(1, 0)
        assert not seen(device, lambda one: one.buttons == frozenset()).twist.any()


@pytest.mark.extras
def test_readings_from_another_thread_are_about_8_ms_apart(virtual: Virtual) -> None:
    times: list[float] = []
    with Gamepad() as device:
        device.open()
        thread = threading.Thread(target=lambda: times.extend(device.read().time for _ in range(50)))
        thread.start()
        thread.join(10)
    assert np.diff(times).min() > 0.004
    assert np.median(np.diff(times)) < 0.03
    assert len(times) == 50


@pytest.mark.extras
def test_a_gamepad_that_is_unplugged_is_a_fault_and_two_alike_are_refused(virtual: Virtual) -> None:
    device = Gamepad()
    device.open()
    device.read()
    second = Virtual()
    try:
        with pytest.raises(DeviceFault, match="2 devices"):
            Gamepad().open()
        with pytest.raises(DeviceFault, match="no gamepad 7"):
            Gamepad("7").open()
    finally:
        second.detach()
    virtual.detach()
    with pytest.raises(DeviceFault, match="is gone"):
        device.read()
    device.close()
    device.close()
    with pytest.raises(DeviceFault, match="closed"):
        device.read()
    with pytest.raises(DeviceFault, match="no gamepad"):
        device.open()


@pytest.mark.extras
def test_signals_stay_the_programs(run_program: Any) -> None:
    pytest.importorskip("pygame", reason="pip install 'robot-control-stack[teleop]'")
    found = run_program(
        """
        from rcs.errors import DeviceFault
        from rcs.teleop.gamepad import Gamepad

        def caught():  # which of SIGHUP, SIGINT and SIGTERM have handlers; without care, SDL takes the last
            status = dict(line.split(":", 1) for line in open("/proc/self/status").read().splitlines())
            return int(status["SigCgt"], 16) & (1 << 0 | 1 << 1 | 1 << 14)

        before = caught()
        try:
            Gamepad().open()
        except DeviceFault as err:
            print(err)
        print(caught() == before)
        """
    )
    assert found.stdout.splitlines() == ["There is no gamepad. Plug it in, or pair it.", "True"], found.stderr
