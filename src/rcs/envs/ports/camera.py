"""The port of real cameras: a thread per camera takes frames, and a step gets the newest with its age."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from rcs_data.scale import Scaler

from rcs.devices import Camera, Frame
from rcs.envs import spaces as keys
from rcs.envs.gates.gate import Gate
from rcs.envs.ports.port import Port
from rcs.envs.spaces import Action, Observation
from rcs.errors import DeviceFault, InvalidSetup, Refused
from rcs.hardware.devices import OnStale
from rcs.robots.calibration import CameraCalibration, describe
from rcs.robots.description import CameraDescription
from rcs.spatial.pinhole import Intrinsics, cropped

_log = logging.getLogger(__name__)

FIRST_FRAME = 10.0
"""How long a camera may take from its opening to its first frame [s]."""
LONGEST_CALL = 2.0
"""How long closing a camera waits for a call of its driver that is under way [s]."""
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
        self.newest: tuple[dict[str, Any], float] | None = None
        """The newest frame as an observation, and when it was taken [s, monotonic]; replaced as a whole."""
        self._camera = camera
        self._take = take
        self._must_end = threading.Event()
        self._has_begun = threading.Event()
        """There is a first frame, or there will be none."""
        self._error: Exception | None = None
        self._thread: threading.Thread | None = None
        self._is_left = False

    def open(self) -> None:
        """Connect the camera and wait for its first frame.

        Raises:
            DeviceFault: There is no first frame, or a call of the camera has not returned since it was last closed.
        """
        if self._thread is not None and not self._must_end.is_set():
            return
        if self._thread is not None and self._thread.is_alive():
            raise DeviceFault(
                f"Camera {self.name!r} is still in a call of its driver that was under way when it was closed; unplug "
                "the camera or end the process."
            )
        self._must_end.clear()
        self._has_begun.clear()
        self._error, self._is_left, self.failure = None, False, ""
        self._thread = threading.Thread(target=self._run, name=f"camera {self.name}", daemon=True)
        self._thread.start()
        if self._has_begun.wait(FIRST_FRAME) and self._error is None:
            return
        self.close()
        why = f": {self.failure}" if self.failure else ""
        raise DeviceFault(f"Camera {self.name!r} has given no frame within {FIRST_FRAME:g} s{why}.")

    def _run(self) -> None:
        try:
            self._camera.open()
            self._read_on()
        except Exception as err:  # noqa: BLE001  raised by `open` or `close`, whoever waits
            self._error = err
        try:
            self._camera.close()
        except Exception as err:  # noqa: BLE001  the same
            self._error = self._error or err
        self._has_begun.set()

    def _read_on(self) -> None:
        last = -1
        pause = 0.25 / max(self._camera.mode.fps, 1.0)
        while not self._must_end.is_set():
            try:
                frame = self._camera.read()
                if frame.number != last:
                    last = frame.number
                    self.newest = self._take(frame), frame.time
                    self.failure = ""
                    self._has_begun.set()
                self._must_end.wait(pause)
            except Exception as err:  # noqa: BLE001  a camera may fail in any way; its age tells, and it is opened again
                if not self.failure:
                    _log.warning("camera %s failed and is opened again: %s", self.name, err)
                if self._camera.is_open:  # else it says no more than that, and why it could not be opened is known
                    self.failure = f"{type(err).__name__}: {err}"
                self._must_end.wait(RECONNECT)
                self._reopen()

    def _reopen(self) -> None:
        try:
            self._camera.close()
            if not self._must_end.is_set():
                self._camera.open()
                if self._camera.fault:
                    self._camera.recover()
        except Exception as err:  # noqa: BLE001  the next read fails too, and tries again
            self.failure = f"{type(err).__name__}: {err}"

    def close(self) -> None:
        """End the thread, which lets go of the camera. Closing twice is harmless.

        A thread whose camera does not return is left behind, with a warning, and closes the camera when it does.
        """
        self._must_end.set()
        if self._thread is None:
            self._camera.close()
        if self._thread is None or self._is_left:
            return
        self._thread.join(LONGEST_CALL)
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


class CameraPort(Port):
    """Real cameras, as `frames`/camera. A frame that is seen again is the same read-only arrays."""

    def __init__(
        self,
        cameras: Mapping[str, Camera],
        descriptions: Mapping[str, CameraDescription],
        *,
        size: tuple[int, int],
        calibrations: Mapping[str, CameraCalibration] | None = None,
        extrinsics: Mapping[str, NDArray[np.float64]] | None = None,
        stale_after: float = 0.5,
        on_stale: OnStale = "fault",
        now: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Use cameras; `open` connects them.

        Args:
            cameras: The devices by name.
            descriptions: Their figures by name; of a camera without, such as that of a tactile sensor, there are
                colours alone.
            size: Width and height of every frame [px]; larger pictures are cut to its shape and made smaller.
            calibrations: Calibrations from a file, by name; others are those of the device, or of the data sheet.
            extrinsics: Poses of cameras that stand still, (4, 4), OpenCV axes; those of others come from a layer.
            stale_after: Age of a frame from which a camera is stale [s].
            on_stale: `fault` ends the episode when a camera is stale; see `Site`.
            now: Monotonic time of the host [s].
        """
        self._size = size
        self.stale_after = self._limit = stale_after
        self._on_stale = on_stale
        self._now = now
        self.timed = tuple(f"{keys.FRAMES}/{name}" for name in cameras)
        self._cameras = dict(cameras)
        self._descriptions = dict(descriptions)
        self._calibrations = dict(calibrations or {})
        self._feeds: dict[str, CameraFeedThread] = {}
        self._takers: dict[str, _Taker] = {}
        frames: dict[str, spaces.Space[Any]] = {}
        for name, camera in cameras.items():
            fixed: dict[str, NDArray[np.float64]] = {}
            if extrinsics is not None and name in extrinsics:
                fixed[keys.EXTRINSICS] = extrinsics[name]
                fixed[keys.EXTRINSICS].flags.writeable = False
            self._takers[name] = _Taker(camera, size, fixed)
            self._feeds[name] = CameraFeedThread(name, camera, self._takers[name])
            own: dict[str, spaces.Space[Any]] = {keys.RGB: keys.rgb_space(*size)}
            if name in descriptions:
                own[keys.INTRINSICS] = keys.intrinsics_space()
                own[keys.DISTORTION] = keys.distortion_space()
            if keys.EXTRINSICS in fixed:
                own[keys.EXTRINSICS] = keys.extrinsics_space()
            if camera.mode.has_depth:
                own[keys.DEPTH] = keys.depth_space(*size)
            frames[name] = spaces.Dict(own)
        self.observation_spaces = {keys.FRAMES: spaces.Dict(frames)}
        self._seen: dict[str, tuple[dict[str, Any], float]] = {}
        self._learn()

    def open(self) -> None:
        """Connect all cameras and wait for a frame of each.

        Raises:
            DeviceFault: A camera gives no frame.
            InvalidSetup: A camera has a calibration that is not valid.
        """
        for feed in self._feeds.values():
            feed.open()
        self._learn()
        for name, feed in self._feeds.items():
            # The first frame was taken before the device was asked for its calibration.
            assert feed.newest is not None, "open waits for a frame"
            feed.newest = {**feed.newest[0], **self._takers[name].fixed}, feed.newest[1]

    def _learn(self) -> None:
        """Ask how the cameras see, which a device may know only when it is open."""
        for name, description in self._descriptions.items():
            seen = intrinsics_of(self._cameras[name], description, self._size, self._calibrations.get(name))
            matrices = {keys.INTRINSICS: seen.matrix, keys.DISTORTION: np.array(seen.distortion)}
            for matrix in matrices.values():
                matrix.flags.writeable = False
            self._takers[name].fixed = {**self._takers[name].fixed, **matrices}

    @property
    def about(self) -> dict[str, Any]:
        """How each camera is calibrated, as far as it is known; a device may know it only when it is open."""
        cameras: dict[str, Any] = {}
        for name in self._descriptions:
            camera = self._cameras[name]
            own, mode = camera.calibration, (camera.mode.width, camera.mode.height)
            if name in self._calibrations:
                cameras[name] = self._calibrations[name].about()
            elif own is not None:
                cameras[name] = {"source": "device", **describe(Intrinsics.of_matrix(own.matrix, mode, own.distortion))}
            else:
                cameras[name] = {"source": "data sheet"}
        return {"cameras": cameras} if cameras else {}

    def observe(self) -> Observation:
        """Return the newest frame of every camera."""
        for name, feed in self._feeds.items():
            if feed.newest is None:
                raise DeviceFault(f"Camera {name!r} has given no frame yet.")
            self._seen[name] = feed.newest
        return {keys.FRAMES: {name: frame for name, (frame, _) in self._seen.items()}}

    def capture_times(self) -> dict[str, float]:
        """Return when the frames that were observed last were taken."""
        return {f"{keys.FRAMES}/{name}": taken for name, (_, taken) in self._seen.items()}

    def stale(self) -> dict[str, str]:
        """Return the cameras that have given nothing new for too long, and why."""
        now = self._now()
        found: dict[str, str] = {}
        for name, feed in self._feeds.items():
            if feed.newest is not None and now - feed.newest[1] > self._limit:
                why = f" ({feed.failure})" if feed.failure else ""
                found[name] = f"no new frame for {now - feed.newest[1]:.2f} s{why}"
        return found

    def faults(self) -> Mapping[str, str]:
        """Return the stale cameras, if that is what they lead to."""
        return self.stale() if self._on_stale == "fault" else {}

    def close(self) -> None:
        """Let go of all cameras."""
        failures: list[Exception] = []
        for feed in self._feeds.values():
            try:
                feed.close()
            except Exception as err:  # noqa: BLE001  the others are closed too; the first failure is raised below
                failures.append(err)
        if failures:
            raise failures[0]


class FreshFrames(Gate):
    """Refuses actions while a camera is stale."""

    needs_joints = False

    def __init__(self, port: CameraPort) -> None:
        """Watch the cameras of a port."""
        self._port = port

    def admit(self, targets: Mapping[str, Action], measured: Mapping[str, Observation]) -> Mapping[str, Action]:
        """Let all through while all frames are fresh.

        Raises:
            Refused: A camera is stale.
        """
        if stale := self._port.stale():
            raise Refused("; ".join(f"camera {name!r}: {why}" for name, why in stale.items()))
        return targets


class _Taker:
    """Makes the observation of a device's frame: cut to the requested shape, and scaled."""

    def __init__(self, camera: Camera, size: tuple[int, int], fixed: Mapping[str, NDArray[np.float64]]) -> None:
        self.fixed = dict(fixed)
        """Entries of every frame besides pixels; replaced as a whole."""
        self._size = size
        self._crop = cropped((camera.mode.width, camera.mode.height), size)
        height, width = (edge.stop - edge.start for edge in self._crop)
        self._scaler = None if (width, height) == size else Scaler((height, width), (size[1], size[0]))
        self._rows = (np.arange(size[1]) + 0.5) * height / size[1]
        self._columns = (np.arange(size[0]) + 0.5) * width / size[0]

    def __call__(self, frame: Frame) -> dict[str, Any]:
        taken: dict[str, Any] = {keys.RGB: frame.rgb[self._crop]}
        if frame.depth_mm is not None:
            taken[keys.DEPTH] = frame.depth_mm[self._crop]
        if self._scaler is not None:
            rgb = np.empty((self._size[1], self._size[0], 3), np.uint8)
            self._scaler(taken[keys.RGB], rgb)
            taken[keys.RGB] = rgb
            if keys.DEPTH in taken:  # a mean of two depths is a place where nothing is
                taken[keys.DEPTH] = taken[keys.DEPTH][np.ix_(self._rows.astype(int), self._columns.astype(int))]
        for array in taken.values():
            array.flags.writeable = False
        return {**taken, **self.fixed}


def intrinsics_of(
    camera: Camera, about: CameraDescription, size: tuple[int, int], calibration: CameraCalibration | None = None
) -> Intrinsics:
    """Return the intrinsics of frames that are cut out of a device's and scaled.

    Args:
        camera: The device; its own calibration counts for more than the data sheet.
        about: The data sheet.
        size: Width and height of the frames [px].
        calibration: From a file; counts for more than both, where it has intrinsics.

    Raises:
        InvalidSetup: The file's pictures have another shape than the device's, or a distortion is not valid.
    """
    mode = (camera.mode.width, camera.mode.height)
    own = camera.calibration
    if calibration is not None and calibration.intrinsics is not None:
        found = calibration.intrinsics
        if abs(found.width * mode[1] - found.height * mode[0]) > max(mode):
            raise InvalidSetup(
                f"Camera {camera.name!r} delivers {mode[0]} x {mode[1]} px; its focal lengths, from its calibration or "
                f"else from the lab's data sheet, are those of {found.width} x {found.height} px, another part of its "
                "sensor. Choose a mode of that shape, or calibrate it with pictures of its own."
            )
    elif own is not None:
        found = Intrinsics.of_matrix(own.matrix, mode, own.distortion)
    else:
        found = Intrinsics.of_matrix(about.intrinsics(*mode), mode)
    return found.cut(size)
