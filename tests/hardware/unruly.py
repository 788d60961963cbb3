"""A driver of fakes that do what a test says at their next call of a kind: crash, hang, raise, lose their link.

Hosts import it by name. A test drops a file into the folder that the option `box` names: its name is the call, its text
the deed; while there is a file `cut`, the link is lost. The log in the same folder says when the devices held.
"""

from __future__ import annotations

import ctypes
import os
import re
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rcs.devices import ArmState, StreamedArm, StreamOptions, StreamPoint
from rcs.devices.fakes import FakeArm, FakeGripper
from rcs.errors import InvalidAction, MissingDependency
from rcs.hardware import Driver, HostTimes


def keep_interpreter(seconds: float) -> None:
    """Keep the interpreter's lock in calls of C, the last one for half of the time, as some libraries do."""
    count, begin = 18, time.perf_counter()
    while time.perf_counter() < begin + seconds:
        re.match(r"(a+)+$", "a" * count + "b")  # takes twice as long with each letter
        count += 1


def raise_index_error() -> None:
    raise IndexError("list index out of range")


def lack_a_package() -> None:
    raise MissingDependency("The driver needs the package 'vendor'; pip install 'robot-control-stack[vendor]'.")


def refuse() -> None:
    raise InvalidAction("the first target is 2 rad away")


def refuse_late() -> None:
    time.sleep(0.05)
    refuse()


DEEDS = {
    "abort": os.abort,
    "crash": lambda: ctypes.string_at(0),
    "exit": lambda: os._exit(7),
    "hang": lambda: time.sleep(60),
    "keep": lambda: keep_interpreter(60),
    "keep half a second": lambda: ctypes.PyDLL(None).usleep(500_000),
    "pause": lambda: time.sleep(0.15),
    "settle": lambda: time.sleep(0.6),
    "raise": raise_index_error,
    "lack": lack_a_package,
    "refuse": refuse,
    "refuse late": refuse_late,
}


def drop(box: Path, call: str, deed: str) -> None:
    """Have the next call of a kind do a deed."""
    (box / "next").write_text(deed)
    (box / "next").rename(box / call)


def holds(box: Path) -> list[float]:
    """Return when devices held [s], on the clock that all processes share."""
    return [float(line) for line in (box / "log").read_text().splitlines()] if (box / "log").exists() else []


class Unruly:
    """The parts that both kinds share; before the class of the fake."""

    box: Path | None = None

    def look(self, call: str) -> None:
        if self.box is None:
            return
        if self.body.has_link and (self.box / "cut").exists():
            self.lose_link()
        self.body.has_link = not (self.box / "cut").exists()
        if not (self.box / call).exists():
            return
        deed = (self.box / call).read_text()
        (self.box / call).unlink()
        if deed.startswith("trip"):
            self.trip("collision")
            if deed == "trip and pause":
                DEEDS["pause"]()
        else:
            DEEDS[deed]()

    def _open(self) -> None:
        self.look("open")
        super()._open()

    def _state(self) -> Any:
        self.look("state")
        return super()._state()

    def _hold(self) -> None:
        self.look("hold")
        if self.box is not None:
            with (self.box / "log").open("a") as log:
                log.write(f"{time.monotonic()}\n")
        super()._hold()

    def _recover(self) -> None:
        self.look("recover")
        super()._recover()

    def _close(self) -> None:
        self.look("close")
        super()._close()


class UnrulyArm(Unruly, FakeArm):
    def _guide(self) -> None:
        self.look("guide")
        super()._guide()

    def _command_joints(self, joints: Any) -> None:
        self.look("command")
        super()._command_joints(joints)


class UnrulyGripper(Unruly, FakeGripper):
    def _command_opening(self, opening: float, force: float | None) -> None:
        self.look("command")
        super()._command_opening(opening, force)


class Servo(StreamedArm):
    """An arm that is where its points are; its mode is for which time between commands it plans."""

    def __init__(self, about: Any) -> None:
        super().__init__("fr3", about.arm_limits, StreamOptions(rate=100.0, missed_ticks=1000))
        self.joints = np.array(about.home)

    def _read(self) -> ArmState:
        return ArmState(self.joints, [0.0] * self.dof, mode=f"{self.period:.4f}")

    def _write(self, point: StreamPoint) -> None:
        self.joints = point.position

    def _stop(self) -> None:
        pass


class ServoDriver(Driver):
    hosted = True

    def arm(self, address: str, about: Any, options: Mapping[str, Any]) -> Servo:
        return Servo(about)


class UnrulyDriver(Driver):
    hosted = True
    host_times = HostTimes(open=1.5)

    def arm(self, address: str, about: Any, options: Mapping[str, Any]) -> UnrulyArm:
        arm = UnrulyArm(about.arm_limits, start=np.array(about.home), name="fr3")
        arm.box = Path(options["box"]) if "box" in options else None
        return arm

    def gripper(self, address: str, about: Any, options: Mapping[str, Any]) -> UnrulyGripper:
        gripper = UnrulyGripper(max_width=about.max_width, max_force=about.max_force, name="hand")
        gripper.box = Path(options["box"]) if "box" in options else None
        return gripper
