"""The port of real cameras: a step gets the newest frame of each, with its age."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from rcs_data.read.scale import Scaler

from rcs.devices import Camera, Frame
from rcs.envs import spaces as keys
from rcs.envs.gates.gate import Gate
from rcs.envs.ports import camera_thread
from rcs.envs.ports.camera_thread import CameraFeedThread
from rcs.envs.ports.port import Port
from rcs.envs.spaces import Action, Observation
from rcs.errors import DeviceFault, InvalidSetup, Refused
from rcs.hardware.devices import OnStale
from rcs.hardware.usb import require_plugs
from rcs.robots.camera import Calibration, CameraDescription, describe
from rcs.spatial.pinhole import Intrinsics, cropped

OPTIONS = "options"
"""Key of a camera's `about` with the options of its site; all others are known for certain only once it is open."""


class CameraPort(Port):
    """Real cameras, as `frames`/camera. A frame that is seen again is the same read-only arrays."""

    def __init__(
        self,
        cameras: Mapping[str, Camera],
        descriptions: Mapping[str, CameraDescription],
        *,
        sizes: Mapping[str, tuple[int, int]],
        calibrations: Mapping[str, Calibration] | None = None,
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
            sizes: Width and height of each camera's frames [px]; larger pictures are cut to that shape and made
                smaller.
            calibrations: Calibrations from a file, by name; others are those of the device, or of the data sheet.
            extrinsics: Poses of cameras that stand still, (4, 4), OpenCV axes; a layer adds those on a gripper.
            stale_after: Age of a frame from which a camera is stale [s].
            on_stale: `fault` ends the episode when a camera is stale; see `Site`.
            now: Monotonic time of the host [s].
        """
        self._sizes = dict(sizes)
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
            self._takers[name] = _Taker(camera, sizes[name], fixed)
            self._feeds[name] = CameraFeedThread(name, camera, self._takers[name])
            own = [keys.RGB, *([keys.INTRINSICS, keys.DISTORTION] if name in descriptions else []), *fixed]
            frames[name] = keys.frame_space([*own, *([keys.DEPTH] if camera.mode.has_depth else [])], sizes[name])
        self.observation_spaces = {keys.FRAMES: spaces.Dict(frames)}
        self._seen: dict[str, tuple[dict[str, Any], float, float]] = {}
        self._learn()

    def check(self) -> None:
        """Check that all cameras are plugged in, are different devices and fit on their buses, before they are opened.

        One that is unplugged later is stale, and its thread opens it again.

        Raises:
            InvalidSetup: They are not, or do not.
        """
        if not all(feed.is_running for feed in self._feeds.values()):
            require_plugs(self._cameras)

    def open(self) -> None:
        """Connect all cameras at once and wait for a frame of each.

        Raises:
            DeviceFault: A camera gives no frame.
            InvalidSetup: A camera has a calibration that is not valid, or does not offer its mode or a control.
            MissingDependency: A driver needs a package that is not installed.
        """
        try:
            started = [feed for feed in self._feeds.values() if feed.start()]
            until = time.monotonic() + camera_thread.FIRST_FRAME
            for feed in self._feeds.values():
                feed.wait(until)
        except BaseException:
            self._let_go()
            raise
        self._learn()
        for feed in started:
            # The first frame was taken before the device's calibration was read.
            feed.amend(self._takers[feed.name].fixed)

    def _learn(self) -> None:
        """Ask how the cameras see, which a device may know only when it is open."""
        for name, description in self._descriptions.items():
            seen = intrinsics_of(self._cameras[name], description, self._sizes[name], self._calibrations.get(name))
            matrices = {keys.INTRINSICS: seen.matrix, keys.DISTORTION: np.array(seen.distortion)}
            for matrix in matrices.values():
                matrix.flags.writeable = False
            self._takers[name].fixed = {**self._takers[name].fixed, **matrices}

    @property
    def about(self) -> dict[str, Any]:
        """The options of each camera, and its calibration where that is from a file."""
        cameras: dict[str, Any] = {}
        for name, camera in self._cameras.items():
            options = {key: value for key, value in getattr(camera, "about", {}).items() if key == OPTIONS}
            calibration = self._calibrations[name].about() if name in self._calibrations else {}
            if options or calibration:
                cameras[name] = {**options, **calibration}
        return {"cameras": cameras} if cameras else {}

    @property
    def device_facts(self) -> dict[str, Any]:
        """Facts that each open camera reports, such as its serial number, and its intrinsics if no file has them."""
        cameras: dict[str, Any] = {}
        for name, camera in self._cameras.items():
            facts = {key: value for key, value in getattr(camera, "about", {}).items() if key != OPTIONS}
            own, mode = camera.calibration, (camera.mode.width, camera.mode.height)
            file = self._calibrations.get(name)
            if file is None or file.intrinsics is None:  # else `about` has them
                if own is not None:
                    facts |= {"source": "device", **describe(Intrinsics.of_matrix(own.matrix, mode, own.distortion))}
                elif name in self._descriptions:
                    facts["source"] = "data sheet"
            if facts:
                cameras[name] = facts
        return {"cameras": cameras} if cameras else {}

    def observe(self) -> Observation:
        """Return the newest frame of every camera."""
        for name, feed in self._feeds.items():
            if feed.newest is None:
                raise DeviceFault(f"Camera {name!r} has given no frame yet.")
            self._seen[name] = feed.newest
        return {keys.FRAMES: {name: frame for name, (frame, *_) in self._seen.items()}}

    def capture_times(self) -> dict[str, float]:
        """Return when the frames that were observed last were taken."""
        return {f"{keys.FRAMES}/{name}": taken for name, (_, taken, _) in self._seen.items()}

    def device_times(self) -> dict[str, float]:
        """Return the same on the cameras' own clocks; NaN for those without one."""
        return {f"{keys.FRAMES}/{name}": at for name, (_, _, at) in self._seen.items()}

    def reconnections(self) -> dict[str, int]:
        """Return how often each camera was opened again, where it was."""
        return {f"{keys.FRAMES}/{name}": feed.reconnections for name, feed in self._feeds.items() if feed.reconnections}

    def stale(self) -> dict[str, str]:
        """Return the cameras that have given nothing new for too long, and why."""
        now = self._now()
        found: dict[str, str] = {}
        for name, feed in self._feeds.items():
            if feed.newest is not None and now - feed.newest[1] > self._limit:
                text = feed.failure or feed.busy()
                why = f" ({text})" if text else ""
                found[name] = f"no new frame for {now - feed.newest[1]:.2f} s{why}"
        return found

    def faults(self) -> Mapping[str, str]:
        """Return the stale cameras, if that is what they lead to."""
        return self.stale() if self._on_stale == "fault" else {}

    def close(self) -> None:
        """Let go of all cameras, within `camera_thread.LONGEST_CALL` in all."""
        if failures := self._let_go():
            raise failures[0]

    def _let_go(self) -> list[Exception]:
        failures: list[Exception] = []
        for feed in self._feeds.values():
            feed.end()
        until = time.monotonic() + camera_thread.LONGEST_CALL
        for feed in self._feeds.values():
            try:
                feed.close(until)
            except Exception as err:  # noqa: BLE001  the others are closed too
                failures.append(err)
        return failures


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
    camera: Camera, about: CameraDescription, size: tuple[int, int], calibration: Calibration | None = None
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
