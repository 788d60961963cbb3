"""The other ends of input devices: what a device, its kernel or its machine would send, as a person wants it."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import json
import os
import pty
import select
import signal
import socket
import ssl
import struct
import subprocess
import sys
import termios
import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import pi, tau
from pathlib import Path
from typing import Any

import numpy as np
from rcs_data.files.closing import Closing

from rcs.spatial import tquat_to_matrix
from rcs.teleop import Button, InputDevice, LeaderCalibration, Vive, credentials, gamepad, keyboard, spacemouse
from rcs.teleop import gello as gello_at
from rcs.teleop import so101_leader as so101_leader_at
from rcs.teleop.headset_messages import TO_FRONT_LEFT_UP
from rcs.teleop.quest import Quest
from rcs.teleop.terminal import ASK, ASK_FOR_PROTOCOL
from rcs.teleop.vive_relay import POSES, RIGHT, Tracked, meet, pack

SERVOS = Path(__file__).parents[2] / "tests" / "teleop" / "leader_bus.py"
STEP = tau / 4096
"""Angle between two positions of a servo [rad]."""


@dataclass
class Want:
    """The wishes of the person at the moment."""

    pose: Any = field(default_factory=lambda: np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    """Pose of the hand [m, xyzw]."""
    way: Any = field(default_factory=lambda: np.zeros(6))
    """Way that the TCP has still to go: translation [m] and rotation vector [rad]."""
    joints: Any = None
    """Joints of the leader [rad]; None for where it is."""
    opening: float = 1.0
    buttons: frozenset[Button] = frozenset()


class End(Closing):
    """The other end of an input: it sends what is wanted at a rate, from a thread of its own."""

    rate = 100.0
    """Messages per second."""
    toggles = False
    """Whether a button opens and closes the gripper, and the clutch is any deflection."""
    has_buttons = True
    """Whether there are buttons, so that the person can begin takes."""
    device: InputDevice
    """The input."""
    beside: Sequence[InputDevice] = ()
    """Devices beside it, of which only the buttons count."""

    def __init__(self) -> None:
        self.want = Want()
        self.is_dead = False
        """Whether it says nothing."""
        self._must_end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="person", daemon=True)

    def start(self) -> None:
        """Begin to send; the device is open."""
        self._thread.start()

    @abstractmethod
    def send(self, want: Want) -> None:
        """Send it once."""

    def die(self, is_dead: bool) -> None:
        """Say nothing any more, or again."""
        self.is_dead = is_dead

    def close(self) -> None:
        """End."""
        self._must_end.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def _run(self) -> None:
        while not self._must_end.wait(1.0 / self.rate):
            if not self.is_dead:
                self.send(self.want)


def pushed(want: Want, speeds: Sequence[float], least: float) -> Any:
    """Return shares of full deflections, (6,): in proportion to the way, but no less than what moves anything."""
    found = np.zeros(6)
    if "clutch" not in want.buttons:
        return found
    for part, speed, enough in ((slice(0, 3), speeds[0], 0.002), (slice(3, 6), speeds[1], 0.015)):
        length = float(np.linalg.norm(want.way[part]))
        if length > enough:
            found[part] = want.way[part] / length * np.clip(3.0 * length / speed, least, 1.0)
    return found


class Knob(End):
    """Reports of a SpaceMouse, through a file like the kernel's."""

    toggles = True

    def __init__(self, folder: Path) -> None:
        super().__init__()
        os.mkfifo(folder / "knob")
        self.device = spacemouse.SpaceMouse(str(folder / "knob"))
        self._file = os.open(folder / "knob", os.O_RDWR)

    def send(self, want: Want) -> None:
        """Send both halves of the deflection, and the buttons."""
        share = pushed(want, (spacemouse.SPEED, spacemouse.TURN_SPEED), 0.12)
        back = spacemouse.TO_FRONT_LEFT_UP.T
        keys = sum(1 << bit for bit, meaning in spacemouse.MEANINGS.items() if meaning in want.buttons)
        moved, turned = (np.round(350 * back @ part).astype(int) for part in (share[:3], share[3:]))
        reports = (
            struct.pack("<B3h", 1, *moved),
            struct.pack("<B3h", 2, *turned),
            bytes([3, keys & 255, keys >> 8 & 255]),
        )
        for report in reports:
            os.write(self._file, report)
            time.sleep(0.002)  # a pipe does not keep reports apart, as the kernel's file does


class Pad(End):
    """SDL's virtual joystick, in the library that pygame brings."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        os.environ.update(gamepad.SETTINGS, SDL_VIDEODRIVER="dummy")
        import pygame

        (path,) = (Path(pygame.__file__).parents[1] / "pygame_ce.libs").glob("libSDL2-2-*.so*")
        self._sdl: Any = ctypes.CDLL(str(path))
        self._sdl.SDL_JoystickOpen.restype = ctypes.c_void_p
        self._sdl.SDL_JoystickSetVirtualAxis.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int16]
        self._sdl.SDL_JoystickSetVirtualButton.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_uint8]
        self._sdl.SDL_InitSubSystem(0x200)
        self._plug_in()
        self.device = gamepad.Gamepad()

    def _plug_in(self) -> None:
        self._number = self._sdl.SDL_JoystickAttachVirtual(1, 6, 15, 0)
        self._stick = self._sdl.SDL_JoystickOpen(self._number)
        self._sdl.SDL_JoystickSetVirtualAxis(self._stick, 5, -32768)

    def die(self, is_dead: bool) -> None:
        """Unplug it, or plug it in: what a stick last said is its state."""
        if not is_dead:
            self._plug_in()
        super().die(is_dead)
        if is_dead:
            time.sleep(2.0 / self.rate)  # nobody moves it meanwhile
            self._sdl.SDL_JoystickDetachVirtual(self._number)

    def close(self) -> None:
        """End, and unplug it."""
        super().close()
        self._sdl.SDL_JoystickDetachVirtual(self._number)

    def send(self, want: Want) -> None:
        """Set sticks, trigger and buttons."""
        share = pushed(want, (gamepad.SPEED, gamepad.TURN_SPEED), 0.05)
        axes = np.array([-share[1], -share[0], -share[5], -share[2]])
        axes += np.sign(axes) * gamepad.REST * (1.0 - np.abs(axes))
        for at, value in enumerate(np.clip(axes, -1.0, 1.0)):
            self._sdl.SDL_JoystickSetVirtualAxis(self._stick, at, round(gamepad.FULL * float(value)))
        self._sdl.SDL_JoystickSetVirtualAxis(self._stick, 5, -32768 + round(65535 * (1.0 - want.opening)))
        for button, meaning in gamepad.MEANINGS.items():
            self._sdl.SDL_JoystickSetVirtualButton(self._stick, button, meaning in want.buttons)


class Keys(End):
    """A terminal with kitty's protocol, which this program has as its own; it leads a session to have one."""

    toggles = True
    rate = 60.0
    enough = 0.003, 0.02
    """Ways that are not worth a key [m, rad]."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._terminal, self._own = pty.openpty()
        fcntl.ioctl(self._own, termios.TIOCSCTTY, 0)
        self.device = keyboard.Keyboard()
        self._held: set[str] = set()
        self._is_fine = False
        threading.Thread(target=self._answer, name="terminal", daemon=True).start()

    def send(self, want: Want) -> None:
        """Press and release keys."""
        keys = {key for key, meaning in keyboard.MEANINGS.items() if meaning in want.buttons}
        if "clutch" in want.buttons:
            is_fine = bool(np.abs(want.way[:3]).max() < 0.03 and np.abs(want.way[3:]).max() < 0.15)
            for _ in range(3 if is_fine != self._is_fine else 0):
                self._tell("-" if is_fine else "=", 1)
                self._tell("-" if is_fine else "=", 3)
            self._is_fine = is_fine
            for key in "wsadrfouikjl":
                axis, sign = keyboard.MOTIONS[key]
                if sign * want.way[axis] > self.enough[axis > 2]:
                    keys.add(key)
        for key in self._held - keys:
            self._tell(key, 3)
        for key in keys - self._held:
            self._tell(key, 1)
        self._held = keys

    def close(self) -> None:
        """End, and give the terminal up, for the next one."""
        super().close()
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        fcntl.ioctl(self._own, termios.TIOCNOTTY)

    def _tell(self, key: str, kind: int) -> None:
        os.write(self._terminal, f"\x1b[{ {'space': 32, 'enter': 13}.get(key) or ord(key) };1:{kind}u".encode())

    def _answer(self) -> None:
        while True:
            select.select([self._terminal], [], [])
            data = os.read(self._terminal, 4096)
            if ASK_FOR_PROTOCOL in data:
                os.write(self._terminal, b"\x1b[?0u\x1b[?62c")
            while ASK in data and self.is_dead:  # a network that fails delays the answer
                time.sleep(0.01)
            if ASK in data:
                os.write(self._terminal, b"\x1b[0n")


class Headset(End):
    """The frames that the page in a headset sends."""

    rate = 72.0

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.device = self._quest = Quest("127.0.0.1:0")
        self._page: Any = None
        self._number, self._began = 0, time.monotonic()

    def send(self, want: Want) -> None:
        """Send a frame."""
        if self._page is None:
            self._page = self._connected()
        place, turn = headset_pose(want.pose)
        bits = {"clutch": 1, "front": 3, "start": 4, "success": 5}
        hand = {
            "pose": [*place.tolist(), *turn.tolist()],
            "trigger": 1.0 - want.opening,
            "buttons": sum(1 << bit for name, bit in bits.items() if name in want.buttons),
            "stick": 0,
        }
        at = 1e3 * (time.monotonic() - self._began)
        self._page.send(json.dumps({"number": self._number, "time": at, "round_trip": 0, "hands": {"right": hand}}))
        self._number += 1
        with contextlib.suppress(TimeoutError):
            while True:  # echoes and pictures, which a page reads too
                self._page.recv(timeout=0)

    def _connected(self) -> Any:
        from websockets.sync.client import connect

        where, _, code = self._quest.url.partition("#")
        trusting = ssl.create_default_context(cafile=credentials.folder() / "teleop.pem")
        page = connect(f"{where.replace('https', 'wss')}stream", ssl=trusting, compression=None)
        page.send(code)
        return page


class Relay(End):
    """The packets of the relay beside SteamVR."""

    rate = 120.0

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.device = self._vive = Vive("127.0.0.1:0")
        self._link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._session, self._number = b"", 0

    def send(self, want: Want) -> None:
        """Send a packet."""
        code = credentials.code()
        if not self._session:
            self._link.connect(("127.0.0.1", int(self._vive.instructions.split()[-2].split(":")[1])))
            self._session = meet(self._link, code)
        place, turn = headset_pose(want.pose)
        matrix = tquat_to_matrix([*place, *turn])[:3].ravel()
        buttons = ("clutch" in want.buttons) << 2 | ("start" in want.buttons) << 1
        wand = Tracked(RIGHT, True, tuple(matrix.tolist()), buttons, 1.0 - want.opening, (0.0, 0.0))
        self._number += 1
        self._link.send(pack(POSES, self._session, self._number, time.perf_counter(), [wand], code))


def headset_pose(pose: Any) -> tuple[Any, Any]:
    """Return place and rotation of a hand in a headset's axes."""
    back = TO_FRONT_LEFT_UP.T
    return back @ pose[:3], np.array([*(back @ pose[3:6]), pose[6]])


class Leader(End):
    """A leader's servos, in a process of their own."""

    has_buttons = False
    rate = 60.0

    def __init__(self, kind: str, count: int, make: Callable[[str], InputDevice], offset: int) -> None:
        super().__init__()
        program = [sys.executable, str(SERVOS), kind, str(count)]
        self._servos = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._servos.stdout is not None
        self.device = make(self._servos.stdout.readline().strip())
        self._offset = offset

    def send(self, want: Want) -> None:
        """Put the servos where they are wanted."""
        if want.joints is not None:
            assert self._servos.stdin is not None
            assert self._servos.stdout is not None
            positions = np.round(np.asarray(want.joints) / STEP + self._offset).astype(int).tolist()
            gripper = round(1000 + 2096 * want.opening)
            given = {"positions": dict(enumerate([*positions, gripper], 1))}
            self._servos.stdin.write(json.dumps(given) + "\n")
            self._servos.stdin.flush()
            self._servos.stdout.readline()

    def die(self, is_dead: bool) -> None:
        """Stop the servos, or let them go on."""
        super().die(is_dead)
        self._servos.send_signal(signal.SIGSTOP if is_dead else signal.SIGCONT)

    def close(self) -> None:
        """End, and the servos."""
        super().close()
        self._servos.kill()
        self._servos.communicate()


def so101_leader(folder: Path) -> End:
    """Return the servos of an SO101 leader."""
    return Leader("feetech", 6, so101_leader_at, 2048)


def gello(folder: Path) -> End:
    """Return the servos of a GELLO for the FR3."""

    def make(port: str) -> InputDevice:
        near = (0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0)
        calibration = LeaderCalibration(
            address=port, signs=(1,) * 7, offsets=(-pi,) * 7, near=near, closed=1000 * STEP, opened=3096 * STEP,
            servos=tuple(range(1, 9)), baud=1_000_000,
        )  # fmt: skip
        calibration.write(folder / "gello.json")
        return gello_at(str(folder / "gello.json"))

    return Leader("dynamixel", 8, make, 2048)


ENDS: dict[str, Callable[[Path], End]] = {
    "spacemouse": Knob, "gamepad": Pad, "keyboard": Keys, "quest": Headset, "vive": Relay,
    "so101_leader": so101_leader, "gello": gello,
}  # fmt: skip
"""By the name of the input."""
