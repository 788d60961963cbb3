"""The driver of Intel RealSense cameras, by the vendor's library."""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Iterable, Mapping
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from rcs.devices import Camera, CameraCalibration, CameraMode, Frame
from rcs.errors import DeviceFault, InvalidSetup, require_fields
from rcs.extras import package_of
from rcs.hardware.device_clock import DeviceClock
from rcs.hardware.driver import Driver
from rcs.hardware.pictures import require_url
from rcs.hardware.programs import holders
from rcs.hardware.realsense_network import NetworkPipeline
from rcs.hardware.usb import Plug, UsbDevice, usb_devices
from rcs.hardware.video_camera import LONGEST_WARM_UP, seconds
from rcs.robots.camera import CameraDescription

_log = logging.getLogger(__name__)

CONTROLS = ("exposure", "gain", "white_balance", "power_line_frequency", "emitter")
OPTIONS = ("warm_up", "latency", "serial", *CONTROLS)
"""Options of a site: `warm_up` [s] drops the first pictures; `latency` [s] is the time that the fastest picture takes;
`serial` is the serial number that a camera at a URL must have; the others set a camera on a USB port: `exposure` [s],
`gain`, `white_balance` [K], `power_line_frequency` (0, 50 or 60 Hz), and `emitter`, whether the pattern for depth is
projected."""
READ_LIMIT = 1.0
"""Longest wait for a picture [s]."""
RESET_AFTER = 4
"""Number of failures in a row after which the camera's hardware is reset."""
CLOCK_STEP = 0.02
"""Change of the wall clock against the monotonic one from which it was set [s]; NTP slews both."""
RAW_BITS = 16
"""Bits per pixel of colours (YUYV) and of depth on the bus."""
RULES = "https://github.com/realsenseai/librealsense/blob/master/config/99-realsense-libusb.rules"
"""The vendor's rules, by which udev lets everybody use the cameras."""


class RealsenseDriver(Driver):
    """Driver of D400 cameras.

    The address is a serial number, the path of a recording (`.db3`, `.bag`) to play, or the URL of a virtual camera.
    """

    def camera(self, address: str, about: CameraDescription, mode: CameraMode, options: Mapping[str, Any]) -> Realsense:
        """Return a camera; its depth, if the mode has it, is aligned to the colours."""
        require_fields("option of a RealSense", options, OPTIONS)
        if mode.has_depth and not about.has_depth:
            raise InvalidSetup(f"{about.label} has no depth; use depth=False, or another camera.")
        return Realsense(address, mode, options)


class Realsense(Camera):
    """A D400 camera, a recording of one, or a virtual one."""

    def __init__(self, address: str, mode: CameraMode, options: Mapping[str, Any]) -> None:
        """Open nothing yet; arguments as in the driver.

        Raises:
            InvalidSetup: An option is not valid.
        """
        for name in CONTROLS:
            value, is_switch = options.get(name, 0), name == "emitter"
            is_number = isinstance(value, int | float) and math.isfinite(value)
            if not is_number or (isinstance(value, bool) and not is_switch):
                raise InvalidSetup(f"{name} is {value!r}; valid is {'true or false' if is_switch else 'a number'}.")
        self._warm_up = seconds("warm_up", options.get("warm_up", 0.0), LONGEST_WARM_UP)
        self._latency = seconds("latency", options.get("latency", 0.0), 1.0)
        super().__init__(f"RealSense {address}", mode)
        self._address, self._options = address, dict(options)
        self._is_on_network = "://" in address
        self._is_recording = not self._is_on_network and address.endswith((".db3", ".bag"))
        self._is_plugged_in = not (self._is_on_network or self._is_recording)
        if self._is_on_network:
            require_url(address)
        elif "serial" in options:
            raise InvalidSetup(
                "serial is an option at a URL; the serial number of a camera on a USB port is its address."
            )
        if not self._is_plugged_in and (given := [name for name in CONTROLS if name in options]):
            what = "is a recording" if self._is_recording else "is on a network"
            raise InvalidSetup(f"The options {given} set a camera; {address} {what}. Leave them out.")
        self._serial = str(options.get("serial", "")) if self._is_on_network else address
        self._pipeline: Any = None
        self._device: Any = None
        self._align: Any = None
        self._millimetres = 1.0
        self._known_calibration: CameraCalibration | None = None
        self._clock = DeviceClock(self._latency)
        self._ahead = math.nan  # of the wall clock, at the picture before
        self._number = self._before = 0  # of the last picture, and of the last one before this connection
        self._failures = 0
        self._is_new = False  # opened, and not read yet
        self._told: dict[str, Any] = {}

    @property
    def about(self) -> dict[str, Any]:
        """Facts for recordings: address, options, and once it is open, the facts that the camera reports."""
        return {"serial": self._serial, "options": self._options, **self._told}

    def plug(self) -> Plug | None:
        """Return its place on a USB bus; None for a recording, and on a network.

        Raises:
            InvalidSetup: It is not plugged in.
        """
        if not self._is_plugged_in:
            return None
        rs = _library()
        place = _place(rs, self._find(rs))
        streams = 2 if self.mode.has_depth else 1
        needs = streams * RAW_BITS * self.mode.width * self.mode.height * self.mode.fps / 1e6
        return None if place is None else Plug(device=place, needs=needs)

    def _open(self) -> None:
        try:
            self._start()
            self._failures, self._is_new = 0, True
        except (InvalidSetup, DeviceFault):
            raise
        except RuntimeError as err:  # the library's own errors
            place = None if self._device is None else _place(_library(), self._device)
            self._fail(err, "" if place is None else _forbidden([place]) or _held(place))

    def _recover(self) -> None:
        if not self._is_new:  # else the fault is from before this connection
            self._stop()
            self._open()

    def _start(self) -> None:
        rs, mode = _library(), self.mode
        if self._is_on_network:
            pipeline = NetworkPipeline(rs, self._address, serial=self._serial)
            self._serial, self._pipeline = pipeline.serial, pipeline
            profile = pipeline.start(self._choose(rs, pipeline.device))
        else:
            config, pipeline = rs.config(), rs.pipeline()
            if self._is_recording:
                config.enable_device_from_file(self._address, False)
                streams = [(rs.stream.color,), (rs.stream.depth,)][: 1 + mode.has_depth]
            else:
                self._device = self._find(rs)
                config.enable_device(self._address)
                streams = self._choose(rs, self._device)
            for stream in streams:
                config.enable_stream(*stream)
            self._pipeline = pipeline
            profile = pipeline.start(config)
        device = profile.get_device()
        if self._is_plugged_in:  # only now: it would also change the pictures of another program, which has them
            self._set_controls(rs, device)
        color = profile.get_stream(rs.stream.color).as_video_stream_profile()
        self._known_calibration = _calibration(rs, color.get_intrinsics())
        if mode.has_depth:
            depth = profile.get_stream(rs.stream.depth).as_video_stream_profile()
            self._align = None if _is_aligned(depth, color) else rs.align(rs.stream.color)
            self._millimetres = 1000.0 * device.first_depth_sensor().get_depth_scale()
        names = {"model": "name", "firmware": "firmware_version", "usb": "usb_type_descriptor"}
        fields = {told: getattr(rs.camera_info, name) for told, name in names.items()}
        self._told = {told: device.get_info(field) for told, field in fields.items() if device.supports(field)}
        self._clock, self._ahead, self._before = DeviceClock(self._latency), math.nan, self._number
        begin, count = time.monotonic(), 0
        while (since := time.monotonic() - begin) < self._warm_up or count < 3 or (count < 10 and since < 0.5):
            self._host_time(rs, self._frames(rs).get_color_frame(), time.monotonic())
            count += 1

    def _read(self) -> Frame:
        self._is_new = False
        rs = _library()
        if self._pipeline is None:
            raise DeviceFault("the camera is not connected")
        try:
            frames = self._frames(rs)
        except RuntimeError as err:
            self._fail(err)
        arrived = time.monotonic()
        color, depth = frames.get_color_frame(), None
        if self.mode.has_depth:
            frames = frames if self._align is None else self._align.process(frames)
            measured = frames.get_depth_frame()
            depth = _in_millimetres(np.asanyarray(measured.get_data()), self._millimetres)
        taken, device_time = self._host_time(rs, color, arrived)
        self._failures = 0
        self._number = self._before + color.get_frame_number()  # the library counts anew after each start
        rgb = np.array(np.asanyarray(color.get_data()), np.uint8)
        return Frame(rgb, depth, number=self._number, time=taken, device_time=device_time)

    def _calibration(self) -> CameraCalibration | None:
        return self._known_calibration

    def _close(self) -> None:
        self._stop()

    def _stop(self) -> None:
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            try:
                pipeline.stop()
            except RuntimeError as err:  # it had not started
                _log.debug("%s: %s", self.name, err)

    def _fail(self, err: Exception, remedy: str = "") -> NoReturn:
        """Raise an error of the library as a fault; after several in a row, reset the camera's hardware before."""
        self._failures += 1
        if self._failures >= RESET_AFTER and self._device is not None:
            self._failures = 0
            _log.warning("%s has failed %d times in a row; its hardware is reset: %s", self.name, RESET_AFTER, err)
            self._device.hardware_reset()
        raise DeviceFault(f"{err}{remedy}") from err

    def _frames(self, rs: Any) -> Any:
        """Return the newest set of pictures: all of them there, and of one moment."""
        until = time.monotonic() + READ_LIMIT
        while True:
            frames = self._pipeline.wait_for_frames(max(1, int(1000 * (until - time.monotonic()))))
            while (newer := self._pipeline.poll_for_frames()).size():
                frames = newer
            color, depth = frames.get_color_frame(), frames.get_depth_frame()
            if color and not self.mode.has_depth:
                return frames
            # The two are free-running; a set that paired neighbours would show things where they were not.
            if color and depth and abs(color.get_timestamp() - depth.get_timestamp()) < 600.0 / self.mode.fps:
                return frames

    def _host_time(self, rs: Any, frame: Any, arrived: float) -> tuple[float, float]:
        """Return when a picture was taken, on the host's clock and on the camera's [s]."""
        at = 1e-3 * frame.get_timestamp()
        if frame.get_frame_timestamp_domain() == rs.timestamp_domain.global_time:  # mapped to Unix time by the library
            before, self._ahead = self._ahead, _wall_ahead()
            if abs(self._ahead - before) > CLOCK_STEP:  # the library follows only in some seconds
                raise DeviceFault(
                    f"this machine's clock was set by {self._ahead - before:.3f} s; pictures have no time"
                )
            taken = at - self._ahead
            if not -0.1 < arrived - taken < 2.0:
                raise DeviceFault(f"the library dates a picture by {arrived - taken:.3f} s; has the clock been set?")
            return min(taken, arrived), at
        return self._clock.host_time(at, arrived), at

    def _find(self, rs: Any) -> Any:
        """Return the camera with the serial number, without starting it: that would wait for 15 s."""
        devices = list(rs.context().query_devices())
        serial = rs.camera_info.serial_number
        for device in devices:
            if device.get_info(serial) == self._address:
                return device
        there = ", ".join(f"{one.get_info(rs.camera_info.name)} ({one.get_info(serial)})" for one in devices)
        shut = _forbidden(one for one in usb_devices() if "RealSense" in one.product)  # the library passes over those
        raise InvalidSetup(
            f"No RealSense has the serial number {self._address!r}. Plugged in: {there or 'none'}{shut}."
        )

    def _choose(self, rs: Any, device: Any) -> list[tuple[Any, int, int, Any, int]]:
        """Return the streams of the mode: kind, width, height, format and rate.

        Depth has the mode's size, or else the largest that there is at this rate.
        """
        mode, offered = self.mode, [one for sensor in device.query_sensors() for one in _modes(rs, sensor)]
        size, rate = (mode.width, mode.height), int(mode.fps)
        colours = {(w, h, r) for kind, w, h, r in offered if kind == rs.stream.color}
        depths = {(w, h, r) for kind, w, h, r in offered if kind == rs.stream.depth}
        if (*size, rate) not in colours:
            each = ", ".join(f"{w}x{h} at {r}" for w, h, r in sorted(colours))
            raise InvalidSetup(f"{self.name} does not offer {size[0]}x{size[1]} at {rate} Hz; it has {each}.")
        streams = [(rs.stream.color, *size, rs.format.rgb8, rate)]
        if not mode.has_depth:
            return streams
        fitting = [(w, h) for w, h, r in depths if r == rate]
        if not depths:
            raise InvalidSetup(f"{self.name} has no depth; use depth=False, or another camera.")
        if not fitting:
            raise InvalidSetup(f"{self.name} has no depth at {rate} Hz; it has {sorted({r for *_, r in depths})}.")
        return [*streams, (rs.stream.depth, *(size if size in fitting else max(fitting)), rs.format.z16, rate)]

    def _set_controls(self, rs: Any, device: Any) -> None:
        """Set the controls of the options and read them back; leave others to the camera."""
        given = self._options
        option = rs.option
        automatic = {"exposure": option.enable_auto_exposure, "white_balance": option.enable_auto_white_balance}
        ids = {name: getattr(option, name) for name in ("exposure", "gain", "white_balance", "power_line_frequency")}
        ids["emitter"] = option.emitter_enabled
        for name in CONTROLS:
            sensors = [one for one in device.query_sensors() if one.supports(ids[name])]
            colours = [one for one in sensors if any(kind == rs.stream.color for kind, *_ in _modes(rs, one))]
            sensors = sensors if name == "emitter" else colours or sensors
            switch = automatic.get(name)
            for sensor in sensors if switch is not None else ():
                if sensor.supports(switch):
                    sensor.set_option(switch, 0.0 if name in given else 1.0)
            if name not in given:
                continue
            if not sensors:
                every = device.query_sensors()
                there = [one for one in CONTROLS if any(sensor.supports(ids[one]) for sensor in every)]
                raise InvalidSetup(f"{self.name} has no control {name!r}; it has {', '.join(there) or 'none'}.")
            scale = 1.0
            if name == "exposure":  # counted in µs by a depth sensor, in 100 µs by others: librealsense #8243, #12006
                scale = 1e6 if sensors[0].is_depth_sensor() else 1e4
            value = float(given[name]) * scale
            if name == "power_line_frequency":
                value = {0.0: 0.0, 50.0: 1.0, 60.0: 2.0}.get(value, math.nan)
            reach = sensors[0].get_option_range(ids[name])
            if not reach.min <= value <= reach.max:
                valid = f"{reach.min / scale:g} to {reach.max / scale:g}"
                valid = "0 (off), 50 or 60 Hz" if name == "power_line_frequency" else valid
                raise InvalidSetup(f"{name} of {self.name} is {given[name]!r}; valid is {valid}.")
            sensors[0].set_option(ids[name], value)
            tolerance = 0.5 if name in ("power_line_frequency", "emitter") else max(reach.step, 1.0)
            if abs((kept := sensors[0].get_option(ids[name])) - value) > tolerance:
                raise DeviceFault(f"{self.name} keeps {name} at {kept:g} when it is set to {value:g}")


def _library() -> Any:
    return package_of("realsense", "pyrealsense2", "A RealSense needs")


def _wall_ahead() -> float:
    """Return by how much the wall clock is ahead of the monotonic one [s]; a pause between both would make it less."""
    return max(time.time() - time.monotonic() for _ in range(3))


def _place(rs: Any, device: Any) -> UsbDevice | None:
    """Return where a camera is plugged in."""
    port = device.get_info(rs.camera_info.physical_port)
    return next((one for one in usb_devices() if f"/{one.path}/" in f"{port}/"), None)


def _forbidden(places: Iterable[UsbDevice]) -> str:
    """Return the files of cameras that this user may not use, and what helps; empty if there are none."""
    files = [file for one in places for file in _files(one) if not os.access(file, os.R_OK | os.W_OK)]
    hint = f"copy {RULES} to /etc/udev/rules.d and plug the camera in again"
    return f"; you may not use {', '.join(files)}: {hint}" if files else ""


def _held(place: UsbDevice) -> str:
    """Return the other programs that have a camera open; empty if there are none."""
    who = sorted({one for file in _files(place) for one in holders(file)})
    return f"; it is held by {', '.join(who)}" if who else ""


def _files(place: UsbDevice) -> list[str]:
    return [f"/dev/{node}" for node in place.nodes if node.startswith("video")]


def _modes(rs: Any, sensor: Any) -> list[tuple[Any, int, int, int]]:
    """Return kind, width, height and rate of a sensor's colours and depths."""
    found: list[tuple[Any, int, int, int]] = []
    for profile in sensor.get_stream_profiles():
        kind = profile.stream_type()
        wanted = {rs.stream.color: rs.format.rgb8, rs.stream.depth: rs.format.z16}.get(kind)
        if profile.is_video_stream_profile() and profile.format() == wanted:
            video = profile.as_video_stream_profile()
            found.append((kind, video.width(), video.height(), video.fps()))
    return found


def _calibration(rs: Any, seen: Any) -> CameraCalibration:
    """Return factory intrinsics; the library counts pixels like OpenCV, from the centre of the first."""
    matrix = np.array([[seen.fx, 0.0, seen.ppx], [0.0, seen.fy, seen.ppy], [0.0, 0.0, 1.0]])
    is_opencv = seen.model in (rs.distortion.brown_conrady, rs.distortion.modified_brown_conrady)
    return CameraCalibration(matrix, list(seen.coeffs) if is_opencv and any(seen.coeffs) else [])


def _is_aligned(depth: Any, color: Any) -> bool:
    """Return whether depth and colours show the same view, as in a D405; aligning would only make holes."""
    pose = depth.get_extrinsics_to(color)
    if any(pose.translation) or not np.allclose(pose.rotation, np.eye(3).ravel()):
        return False
    views = [(one.width, one.height, one.fx, one.fy, one.ppx, one.ppy) for one in (depth.intrinsics, color.intrinsics)]
    return np.allclose(views[0], views[1])


def _in_millimetres(raw: NDArray[np.uint16], scale: float) -> NDArray[np.uint16]:
    """Return depth in millimetres; what is farther than 65.5 m counts as no reading."""
    if abs(scale - 1.0) < 1e-4:
        return raw.copy()
    scaled = np.rint(raw * scale)
    return np.where(scaled > np.iinfo(np.uint16).max, 0, scaled).astype(np.uint16)
