"""RealSense cameras of the vendor's library that a program fills with pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.robots.camera import ResolutionMode
from rcs.spatial import Intrinsics

DEPTH_UNIT = 0.001
"""Length that one count of depth is [m]."""
_COLOR, _DEPTH = "RGB Camera", "Stereo Module"


class SoftwareCamera:
    """A software device with the streams of a D400 camera: colours, and depth as seen by the colour sensor."""

    def __init__(
        self, rs: Any, *, serial: str, name: str, modes: Mapping[ResolutionMode, Intrinsics], has_depth: bool
    ) -> None:
        """Make the device.

        Args:
            rs: The vendor's library.
            serial: Its serial number.
            name: Its name.
            modes: Its modes, each with how the camera sees in it.
            has_depth: Whether it has depth, in the same modes.
        """
        self.device = rs.software_device()
        """The device, for the library's own functions."""
        self.device.register_info(rs.camera_info.serial_number, serial)
        self.device.register_info(rs.camera_info.name, name)
        self._rs = rs
        kinds = [(_COLOR, rs.stream.color, rs.format.rgb8, 3), (_DEPTH, rs.stream.depth, rs.format.z16, 2)]
        self._sensors: list[Any] = []
        self._profiles: list[dict[tuple[int, int, int], Any]] = []
        for label, kind, format, bytes_per_pixel in kinds[: 1 + has_depth]:  # noqa: A001  the library's word
            sensor = self.device.add_sensor(label)
            profiles: dict[tuple[int, int, int], Any] = {}
            for mode, seen in modes.items():
                for rate in mode.rates:
                    stream = rs.video_stream()
                    stream.type, stream.index, stream.fmt, stream.bpp = kind, 0, format, bytes_per_pixel
                    stream.uid = len(profiles) + 1000 * len(self._sensors)
                    stream.width, stream.height, stream.fps = mode.width, mode.height, rate
                    stream.intrinsics = _intrinsics(rs, seen)
                    profiles[mode.width, mode.height, rate] = sensor.add_video_stream(stream).as_video_stream_profile()
            self._sensors.append(sensor)
            self._profiles.append(profiles)
        if has_depth:
            self._sensors[1].add_read_only_option(rs.option.depth_units, DEPTH_UNIT)
            same = rs.extrinsics()
            same.rotation, same.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 0]
            for which, profile in self._profiles[1].items():
                profile.register_extrinsics_to(self._profiles[0][which], same)

    def put(
        self,
        rgb: NDArray[np.uint8],
        depth_mm: NDArray[np.uint16] | None,
        *,
        rate: int,
        moment: float,
        number: int,
    ) -> None:
        """Have the sensors deliver a picture, as far as they are started.

        Args:
            rgb: Colours, (H, W, 3).
            depth_mm: Depth [mm], (H, W); None to deliver none.
            rate: Rate of the mode [1/s].
            moment: When it was taken, on the camera's clock [s].
            number: Its number.
        """
        rs = self._rs
        height, width = rgb.shape[:2]
        for sensor, profiles, pixels in zip(self._sensors, self._profiles, (rgb, depth_mm), strict=False):
            if pixels is None:
                continue
            frame = rs.software_video_frame()
            frame.pixels, frame.bpp = np.ascontiguousarray(pixels), 3 if pixels is rgb else 2
            frame.stride = width * frame.bpp
            frame.timestamp, frame.domain = 1e3 * moment, rs.timestamp_domain.hardware_clock
            frame.frame_number, frame.profile = number, profiles[width, height, rate]
            if pixels is not rgb:
                frame.depth_units = DEPTH_UNIT
            # In thousandths. Without it the library measures 0 after a while, and pairs no picture with its depth.
            sensor.set_metadata(rs.frame_metadata_value.actual_fps, 1000 * rate)
            sensor.on_video_frame(frame)


def _intrinsics(rs: Any, seen: Intrinsics) -> Any:
    told = rs.intrinsics()
    told.width, told.height = seen.width, seen.height
    told.fx, told.fy, told.ppx, told.ppy = seen.fx, seen.fy, seen.cx, seen.cy
    told.model = rs.distortion.brown_conrady if seen.is_distorted else rs.distortion.none
    told.coeffs = [float(value) for value in seen.distortion]
    return told
