"""The interface of an input device: what a person's hands are doing, and when that was measured.

A device only measures. Clutch, scale, filter, speed bounds and the reaction to silence are the operator's, once for all
devices; so a device neither smooths, nor bounds, nor repeats an old reading as a new one.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, Protocol, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray
from rcs_data.files.closing import Closing

from rcs.envs.spaces import Observation
from rcs.errors import DeviceFault

Button = Literal[
    "clutch", "gripper", "front", "start", "success", "failure", "discard", "stop", "reset", "takeover"
]  # fmt: skip
"""The meaning of a button that is held down.

`clutch` couples the hand to the robot as long as it is held. `gripper` opens or closes at each press. `front` says that
the person faces the robot's front as this hand points now, for both hands. `start` begins a take, or ends it without a
verdict; `success`, `failure` and `discard` end it with one; `reset` begins the next episode, `stop` ends the session,
and `takeover` gives the robot from a policy to the person and back.
"""

BUTTONS: tuple[Button, ...] = get_args(Button)
"""All meanings."""

OF_HANDS: frozenset[Button] = frozenset({"clutch", "gripper", "front"})
"""Meanings that concern a hand; the others are requests."""

Motion = tuple[Literal["pose", "twist", "joints"], int]
"""Kind of motion of a hand that a device measures, and how many numbers it has."""

POLL = 0.1
"""Longest time that `read` waits [s]."""


@dataclass(frozen=True, kw_only=True)
class HandReading:
    """One hand, or one arm of a leader. At most one of `pose`, `twist` and `joints` is given, the same in all readings.

    The device's frame is level: x to its front, y to the left, z up. Only the way that a hand makes matters, never
    where it is.
    """

    pose: NDArray[np.float64] | None = None
    """Pose of the hand in the device's frame, (7,): translation [m] and quaternion xyzw."""
    twist: NDArray[np.float64] | None = None
    """Wanted velocity of the TCP along and about the axes of the device's frame, (6,): [m/s], [rad/s]."""
    joints: NDArray[np.float64] | None = None
    """Joints of a leader, as those of the robot that follows, (dof,): [rad]."""
    opening: float | None = None
    """Wanted opening of the gripper, 0 closed … 1 open; None if a button opens and closes it."""
    buttons: frozenset[Button] = frozenset()
    """Buttons that are held down. A device without a clutch of its own says `clutch` while it is deflected, or a key of
    it is held."""
    is_tracked: bool = True
    """Whether the device knows where the hand is."""
    is_there: bool = True
    """Whether it knows the buttons, as also those of a controller that it does not see."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """All hands at one moment."""

    time: float
    """When the device was sampled [s, `time.monotonic()`]."""
    hands: Mapping[str, HandReading]
    """By name: `left` and `right` of devices with two, `right` alone of devices with one."""
    device_time: float | None = None
    """The same on the device's own clock [s]; None if it has none. One that stands still makes a reading stale."""
    counts: Mapping[str, int] = field(default_factory=dict[str, int])
    """Counts of what the device could not use since `open`, by its kind, such as `damaged` messages."""


class InputDevice(Closing, ABC):
    """A device by which a person leads robots. Entry points of `rcs.inputs` are called with an address, or with None.

    The operator calls `open`, then `read` again and again from one thread of its own, and `close` from any thread.
    `feedback` comes from the loop's thread and returns at once.
    """

    valid_for: float = 0.1
    """Age from which a reading is stale [s]: about four periods of the device, and at least 0.05."""
    hands: tuple[str, ...] = ("right",)
    """Names of the hands that readings have, known before `open`."""
    has_clutch: bool = True
    """False for leaders without any button: they engage when they were moved and are still for a second, near the
    follower's joints.
    A device with buttons alone, such as a pedal, gives readings of `hands` without pose, twist or joints."""
    has_takeover: bool = True
    """Whether one of its buttons may mean `takeover`."""
    motion: Motion = ("pose", 7)
    """Which of `pose`, `twist` and `joints` its readings have, and of how many numbers, for recordings."""
    instructions: str = ""
    """Instructions for the person once the device is open, such as the address of a page; empty for nothing."""

    @abstractmethod
    def open(self) -> None:
        """Connect; nothing moves.

        Raises:
            DeviceFault: The device is not there, there are two alike, or it may not be opened; the message has the
                remedy, such as a udev rule.
            InvalidSetup: The address makes no sense, or a port is taken.
            MissingDependency: A package is not installed.
        """

    @abstractmethod
    def read(self) -> Reading | None:
        """Return the next reading, or None if there is none within `POLL`; also while nobody is connected.

        Messages that cannot be used are left out and counted; they raise nothing.

        Raises:
            DeviceFault: The device is lost. The operator holds, closes it and opens it again.
        """

    def feedback(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Show the person what the robot does: pictures, rumble, torques of a leader.

        Args:
            observation: The observation of the last step.
            info: Its info, with `operator`: the state of each hand by name, which is `engaged`, `released` or `held`;
                and with `led`: the robot of each hand by name.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of the device, and end a `read` that waits. Closing twice is harmless."""


class Closable(Protocol):
    """A file, a port or the like."""

    def close(self) -> None:
        """Give it back."""
        ...


Connection = TypeVar("Connection", bound=Closable)


class Connected(InputDevice, Generic[Connection]):
    """An input device with a connection: one thread reads it, and any thread may close it."""

    what: str
    """The device in messages."""

    def __init__(self) -> None:
        """Connect nothing."""
        self._lock = threading.Lock()
        self._connection: Connection | None = None
        self._must_close = False

    @abstractmethod
    def connect(self) -> Connection:
        """Return the connection; faults as in `InputDevice.open`."""

    @abstractmethod
    def measure(self, connection: Connection) -> Reading | None:
        """Return the next reading, as `InputDevice.read`."""

    def open(self) -> None:
        """Connect, in place of the last connection; faults as in `InputDevice.open`."""
        self.close()
        self._connection, self._must_close = self.connect(), False

    def read(self) -> Reading | None:
        """Return the next reading; None and faults as in `InputDevice.read`."""
        with self._lock:
            if self._connection is None or self._must_close:
                raise DeviceFault(f"The {self.what} is closed; open it first.")
            return self.measure(self._connection)

    def close(self) -> None:
        """Close the connection as soon as nobody reads; closing twice is harmless."""
        self._must_close = True  # a thread that reads again and again would not let go of the lock
        with self._lock:
            if self._connection is not None:
                connection, self._connection = self._connection, None
                connection.close()
