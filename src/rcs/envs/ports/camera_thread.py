"""A thread per real camera, which takes its frames and opens it again when it fails."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from rcs.devices import Camera, Frame
from rcs.errors import DeviceFault, InvalidSetup, MissingDependency

_log = logging.getLogger(__name__)

FIRST_FRAME = 10.0
"""How long a camera may take from its opening to its first frame [s]."""
LONGEST_CALL = 1.0
"""How long closing all cameras waits for calls of their drivers that are under way [s]."""
RECONNECT = 1.0
"""How long to wait before a camera that failed is opened again [s]."""


class CameraFeedThread:
    """Reads one camera on a thread of its own, and opens it again when it fails.

    All calls of the driver that may block are on the thread, so that no caller waits for them without limit.
    """

    def __init__(self, name: str, camera: Camera, take: Callable[[Frame], dict[str, Any]]) -> None:
        """Read nothing yet.

        Args:
            name: Name of the camera in the setup.
            camera: The device.
            take: Makes the observation of a frame, on the thread.
        """
        self.name = name
        self.failure = ""
        """Why the last read failed; empty when it did not."""
        self.newest: tuple[dict[str, Any], float, float] | None = None
        """The newest frame as an observation, when it was taken [s, monotonic], and the same on the device's own clock
        (NaN without one); replaced as a whole."""
        self._camera = camera
        self._take = take
        self.reconnections = 0
        """How often the camera was opened again since the first frame."""
        self._lock = threading.Lock()
        """Held while `newest` is replaced."""
        self._must_end = threading.Event()
        self._has_begun = threading.Event()
        """There is a first frame, or there will be none."""
        self._error: Exception | None = None
        self._thread: threading.Thread | None = None
        self._is_left = False
        self._called: float | None = None

    @property
    def is_running(self) -> bool:
        """Whether the camera is connected, or being connected, and its end was not requested."""
        return self._thread is not None and not self._must_end.is_set()

    def start(self) -> bool:
        """Connect the camera and read it, on the thread; return False where that has begun before.

        Raises:
            DeviceFault: A call of the camera has not returned since it was last closed.
        """
        if self.is_running:
            return False
        if self._thread is not None and self._thread.is_alive():
            raise DeviceFault(
                f"Camera {self.name!r} is still in a call of its driver that was under way when it was closed. Try "
                "again in some seconds; if it stays so, unplug the camera or end the process."
            )
        self._must_end.clear()
        self._has_begun.clear()
        self._error, self._is_left, self.failure, self.reconnections = None, False, "", 0
        self._thread = threading.Thread(target=self._run, name=f"camera {self.name}", daemon=True)
        self._thread.start()
        return True

    def wait(self, until: float) -> None:
        """Wait for the first frame.

        Args:
            until: When to give up [s, monotonic].

        Raises:
            InvalidSetup: The camera is not there, or does not offer its mode or a control.
            MissingDependency: Its driver needs a package that is not installed.
            DeviceFault: There is none for another reason.
        """
        if self._has_begun.wait(max(until - time.monotonic(), 0.0)) and self._error is None:
            return
        if isinstance(self._error, InvalidSetup | MissingDependency):
            raise self._error
        if self._error is not None:
            raise DeviceFault(f"Camera {self.name!r} cannot be opened: {self._error}") from self._error
        why = self.failure or self.busy()
        raise DeviceFault(
            f"Camera {self.name!r} has given no frame within {FIRST_FRAME:g} s{f': {why}' if why else ''}."
        )

    def amend(self, entries: Mapping[str, Any]) -> None:
        """Add entries to the newest frame that were not known yet when it was taken; `take` has them from now on."""
        with self._lock:
            if self.newest is not None:
                frame, taken, at = self.newest
                self.newest = {**frame, **entries}, taken, at

    def busy(self) -> str:
        """Return how long the driver has been in one call, if that is long enough to explain a missing frame."""
        since = self._called
        lasted = 0.0 if since is None else time.monotonic() - since
        return f"its driver has not returned from a call for {lasted:.1f} s" if lasted > 0.2 else ""

    def _run(self) -> None:
        try:
            self._called = time.monotonic()
            self._connect()
            self._read_on()
        except Exception as err:  # noqa: BLE001  raised by `wait` or `close`, whoever waits
            self._error, self.failure = err, self.failure or str(err)
        try:
            self._camera.close()
        except Exception as err:  # noqa: BLE001  the same
            self._error = self._error or err
        self._has_begun.set()

    def _read_on(self) -> None:
        last, pause = -1, 0.25 / max(self._camera.mode.fps, 1.0)
        while not self._must_end.is_set():
            try:
                self._called = time.monotonic()
                frame = self._camera.read()
                self._called = None
                if frame.number != last:
                    last = frame.number
                    self._keep(frame)
                self._must_end.wait(pause)
            except Exception as err:  # noqa: BLE001  a camera may fail in any way; its age shows it, and it is reopened
                self._called = None
                if not self.failure:
                    _log.warning("camera %s failed and is opened again: %s", self.name, err)
                if self._camera.is_open:  # else it says no more than that, and why it could not be opened is known
                    self.failure = f"{type(err).__name__}: {err}"
                self._must_end.wait(RECONNECT)
                self._reopen()

    def _keep(self, frame: Frame) -> None:
        with self._lock:
            if self.newest is not None and not frame.time > self.newest[1] and self._has_begun.is_set():
                return  # an older picture that was overtaken
            self.newest = self._take(frame), frame.time, frame.device_time
        self.failure = ""
        self._has_begun.set()

    def _reopen(self) -> None:
        try:
            self._called = time.monotonic()
            self._camera.close()
            if not self._must_end.is_set():
                self._connect()
                self.reconnections += self._has_begun.is_set()
        except Exception as err:  # noqa: BLE001  the next read fails too, and tries again
            self.failure = f"{type(err).__name__}: {err}"
        self._called = None

    def _connect(self) -> None:
        """Open the camera, and have it leave a fault from before."""
        self._camera.open()
        if self._camera.fault:
            self._camera.recover()

    def end(self) -> None:
        """Ask the thread to let go of the camera; `close` waits for it."""
        self._must_end.set()

    def close(self, until: float | None = None) -> None:
        """End the thread, which lets go of the camera. Closing twice is harmless.

        A thread whose camera does not return is left behind, with a warning, and closes the camera when it does.

        Args:
            until: How long to wait for the thread [s, monotonic]; None for `LONGEST_CALL` from now.
        """
        self.end()
        if self._thread is None:
            self._camera.close()
        if self._thread is None or self._is_left:
            return
        self._thread.join(LONGEST_CALL if until is None else max(until - time.monotonic(), 0.0))
        self._is_left = self._thread.is_alive()
        if self._is_left:
            _log.warning(
                "camera %s has not returned from a call of its driver for %g s; its thread is left behind, and closes "
                "the camera when the call returns",
                self.name,
                LONGEST_CALL,
            )
            return
        self._thread = None
        if self._error is not None:
            raise self._error
