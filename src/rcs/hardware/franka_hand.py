"""The Franka Hand, through `franky-control`.

Its calls return once the fingers stand still, and it sends at most 30 states a second, so each has a thread of its own.
"""

from __future__ import annotations

import math
import threading
import time
from typing import Any, Final

from rcs.devices import Gripper, GripperState
from rcs.errors import DeviceFault, WrongOrder
from rcs.extras import package_of
from rcs.hardware.franka_faults import advice_for, connected
from rcs.robots.description import GripperDescription

SAME: Final = 1e-3
"""Widths that differ by less count as equal and do not interrupt a motion [m]."""
SILENCE: Final = 0.3
"""Age of the last state from which the hand counts as silent [s]."""
STOPPING: Final = 0.1
"""Time after which fingers that still move are stopped again [s]."""
CLOSING: Final = 1.5
"""Timeout for the end of a connection that is silent [s]; the library gives up after a second."""


class FrankaHand(Gripper):
    """A Franka Hand. Closing fingers grasp whatever they meet, with the force of the command."""

    def __init__(self, address: str, about: GripperDescription) -> None:
        """Create the hand; `open` connects.

        Args:
            address: Address of the control box.
            about: Description of the hand.
        """
        super().__init__(f"{about.name} at {address}", about.max_width, about.max_force)
        self._address, self._about = address, about
        self._hand: Any = None
        self._state_now: Any = None
        self._measured_at = 0.0
        self._news = threading.Condition()
        self._wanted: tuple[float, float] | None = None  # width [m], force [N]
        self._given: tuple[float, float] | None = None  # the command in progress, or the last one
        self._is_busy = self._is_homing = False
        self._motion = self._stopped = 0  # numbers of the latest motion, and of the latest one that was stopped
        self._stopping = threading.Lock()
        self._is_held = False  # since the motion in progress was commanded
        self._over_since = 0.0  # time of the last stop of the motion in progress
        self._ends = threading.Event()  # of one connection
        self._problem = ""
        self._threads: list[threading.Thread] = []

    def home(self) -> None:
        """Open and close the fingers fully, so that the hand learns its range; needed once after power-on.

        Raises:
            WrongOrder: The hand is not connected, or moves; or a hold has ended its homing.
            DeviceFault: The hand is in its fault state, or has failed to home.
        """
        self.state()
        with self._news:
            if self.fault:
                raise DeviceFault(
                    f"{self.name}: home is refused in the fault state ({self.fault}); call recover() first"
                )
            if self._is_busy or self._wanted is not None:
                raise WrongOrder(f"{self.name}: home was called while the fingers move; wait until has_arrived()")
            self._is_busy = self._is_homing = True
            self._is_held, self._motion = False, self._motion + 1
        try:
            self._hand.homing()
        except Exception as err:  # the library's exceptions have no common base class
            if "aborted" in str(err):
                raise WrongOrder(f"{self.name}: a hold has ended the homing; home it again") from err
            self.set_fault(f"homing failed: {err}")
            raise DeviceFault(f"{self.name}: {self.fault}") from err
        finally:
            with self._news:
                self._given = None  # the fingers are elsewhere
                self._is_busy = self._is_homing = False

    def _open(self) -> None:
        franky = package_of("franka", "franky", "The driver franka needs")
        self._hand = connected(lambda: franky.Gripper(self._address), self._address, "the hand")
        self._state_now = self._hand.state
        self._measured_at = time.monotonic()
        self._wanted = self._given = None
        self._is_busy = False
        self._problem = ""
        self._ends = ends = threading.Event()
        self._threads = [
            threading.Thread(target=target, args=(self._hand, ends), name=f"{self.name} {what}", daemon=True)
            for what, target in (("state", self._watch), ("commands", self._act))
        ]
        for thread in self._threads:
            thread.start()

    @property
    def _is_silent(self) -> bool:
        return time.monotonic() - self._measured_at > SILENCE

    def _state(self) -> GripperState:
        problem = self._problem
        if self._is_silent:
            age = time.monotonic() - self._measured_at
            problem = problem or f"the hand has sent no state for {age:.2f} s. {advice_for(self._address)}"
        if problem:
            self.set_fault(problem)
            raise DeviceFault(f"{self.name}: {problem}")
        # The library's time of a state is the number of its message, counted as milliseconds: no time of 30 states/s.
        return GripperState(
            min(max(self._state_now.width / self.max_width, 0.0), 1.0), math.nan, time=self._measured_at
        )

    def _command_opening(self, opening: float, force: float | None) -> None:
        self._state()
        if self._is_homing:
            raise WrongOrder(f"{self.name}: the hand is being homed; command it when `home` has returned")
        if self._state_now.max_width < SAME:
            raise WrongOrder(
                f"{self.name}: the hand has not been homed since it was switched on; home it in Desk "
                f"(https://{self._address}/desk), which opens and closes its fingers"
            )
        wanted = (opening * self.max_width, self._about.grasp_force if force is None else force)
        with self._news:
            if _is_same(wanted, self._wanted or self._given or (self._state_now.width, wanted[1])):
                return
            self._wanted, self._over_since = wanted, time.monotonic()
            motion = self._motion
            self._news.notify_all()
        self._end(motion)

    def _has_arrived(self) -> bool:
        self._state()
        with self._news:
            return not self._is_busy and self._wanted is None

    def _hold(self) -> None:
        with self._news:
            self._wanted, motion = None, self._motion
            if self._is_busy:
                self._given, self._is_held, self._over_since = None, True, time.monotonic()
        if not self._problem:
            self._end(motion)

    def _end(self, motion: int) -> None:
        """Stop the fingers once if they are still in a motion, by one call at a time.

        The library keeps the answers for all threads in one table, which calls that end together may damage.
        """
        with self._stopping:
            if self._is_busy and motion == self._motion != self._stopped:
                self._hand.stop()
                self._stopped = motion

    def _recover(self) -> None:
        if self._is_silent:  # the library cannot reconnect, and the hand serves one connection
            self._ends.set()
            for thread in self._threads[:1]:  # none after an attempt that failed
                thread.join(CLOSING)
            self._close()
            self._open()
        self._problem = ""

    def _close(self) -> None:
        with self._news:
            self._ends.set()
            self._news.notify_all()
        for thread in self._threads:
            thread.join(timeout=SILENCE)
        self._threads = []
        self._hand = None

    def _watch(self, hand: Any, ends: threading.Event) -> None:
        while True:
            try:
                state = hand.state
            except Exception as err:  # noqa: BLE001 - the library's exceptions have no common base class
                if ends.is_set():
                    return
                self._problem = (
                    self._problem or f"the connection to the hand is lost: {err}. {advice_for(self._address)}"
                )
                return
            if ends.is_set():
                return
            self._state_now, self._measured_at = state, time.monotonic()
            with self._news:
                is_over = self._is_busy and self._is_over and not self._stopping.locked()
                is_late = is_over and time.monotonic() > self._over_since + STOPPING
                if is_late:  # the stop preceded the library's call, and had no effect
                    self._over_since = time.monotonic()
            if is_late:
                hand.stop_async()  # which reports nothing, and lets the states be read

    def _act(self, hand: Any, ends: threading.Event) -> None:
        while True:
            with self._news:
                if ends.is_set():
                    return
                self._is_busy = False
                self._news.wait_for(lambda: ends.is_set() or self._wanted is not None)
                if ends.is_set() or self._wanted is None:
                    return
                self._given, self._wanted = self._wanted, None
                self._is_busy, self._is_held, self._motion = True, False, self._motion + 1
                width, force = self._given
            try:
                self._move(hand, width, force)
            except Exception as err:  # noqa: BLE001 - the library's exceptions have no common base class
                with self._news:
                    self._given = None  # the same command is sent again
                if "aborted" not in str(err) and not ends.is_set():  # by a newer command, or by a hold
                    self._problem = f"the hand has failed to execute a command: {err}"

    @property
    def _is_over(self) -> bool:
        """Whether a hold or a newer command ends the motion in progress."""
        return self._is_held or self._wanted is not None

    def _move(self, hand: Any, width: float, force: float) -> None:
        speed, is_closing = 2.0 * self._about.closing_speed, width < self._state_now.width
        # A grasp continues until the fingers meet something, whatever the width; a move ends at an obstacle without
        # pressing on it.
        if width > SAME and not self._is_over and (hand.move(width, speed) or not is_closing):
            return
        if not self._is_over:
            hand.grasp(width, speed, force, epsilon_inner=self.max_width, epsilon_outer=self.max_width)


def _is_same(first: tuple[float, float], second: tuple[float, float]) -> bool:
    return abs(first[0] - second[0]) < SAME and first[1] == second[1]
