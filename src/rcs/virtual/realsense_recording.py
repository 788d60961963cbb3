"""Recordings of virtual RealSense cameras, which the vendor's library plays like a camera."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.extras import package_of

Pictures = tuple[NDArray[np.uint8], NDArray[np.uint16] | None, float]
"""Colours (H, W, 3), depth in millimetres (H, W) or None, and the moment that they show [s]."""


def write_recording(
    path: Path | str,
    pictures: Iterable[Pictures],
    *,
    matrix: NDArray[np.float64],
    fps: int,
    serial: str = "virtual",
    name: str = "Virtual RealSense",
) -> int:
    """Record pictures as if a camera took them, in real time.

    Args:
        path: File to write, `.db3`.
        pictures: The pictures, all of one size, in the order of their moments.
        matrix: Camera matrix [px], (3, 3), of colours and depth.
        fps: Rate of the pictures [1/s].
        serial: Serial number of the camera.
        name: Its name.

    Returns:
        The number of pictures.

    Raises:
        InvalidSetup: The file exists, has another ending, or there is no picture.
    """
    path = Path(path)
    if path.suffix != ".db3" or path.exists():
        raise InvalidSetup(f"A recording cannot be written to {path}; valid is a new file that ends in .db3.")
    rs = package_of("realsense", "pyrealsense2", "A recording needs")
    remaining = iter(pictures)
    first = next(remaining, None)
    if first is None:
        raise InvalidSetup("A recording needs at least one picture.")
    camera = rs.software_device()
    camera.register_info(rs.camera_info.serial_number, serial)
    camera.register_info(rs.camera_info.name, name)
    size = first[0].shape[1::-1]
    kinds: list[tuple[Any, ...]] = [("RGB Camera", rs.stream.color, rs.format.rgb8, 3)]
    if first[1] is not None:
        kinds.append(("Stereo Module", rs.stream.depth, rs.format.z16, 2))
    sensors = [camera.add_sensor(kind[0]) for kind in kinds]
    profiles = [
        sensor.add_video_stream(_stream(rs, kind, uid, size, matrix, fps)).as_video_stream_profile()
        for uid, (sensor, kind) in enumerate(zip(sensors, kinds, strict=True))
    ]
    if len(sensors) == 2:
        sensors[1].add_read_only_option(rs.option.depth_units, 0.001)
        same = rs.extrinsics()
        same.rotation, same.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 0]
        profiles[1].register_extrinsics_to(profiles[0], same)
    recorder = rs.recorder(str(path), camera)
    written = recorder.query_sensors()
    for sensor in written:
        sensor.open(sensor.get_stream_profiles())
        sensor.start(lambda _: None)
    count, begin = 0, time.monotonic()
    for rgb, depth_mm, moment in (first, *remaining):
        for sensor, profile, pixels, bytes_per_pixel in zip(sensors, profiles, (rgb, depth_mm), (3, 2), strict=False):
            frame = rs.software_video_frame()
            frame.pixels, frame.bpp = np.ascontiguousarray(pixels), bytes_per_pixel
            frame.stride = size[0] * bytes_per_pixel
            frame.timestamp, frame.domain = 1e3 * moment, rs.timestamp_domain.hardware_clock
            frame.frame_number, frame.profile = count + 1, profile
            if bytes_per_pixel == 2:
                frame.depth_units = 0.001
            sensor.on_video_frame(frame)
        count += 1
        time.sleep(max(begin + count / fps - time.monotonic(), 0.0))  # the file has the times of arrival, too
    for sensor in written:
        sensor.stop()
        sensor.close()
    return count


def _stream(
    rs: Any, kind: tuple[Any, ...], uid: int, size: tuple[int, int], matrix: NDArray[np.float64], fps: int
) -> Any:
    seen = rs.intrinsics()
    seen.width, seen.height = size
    seen.fx, seen.fy, seen.ppx, seen.ppy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    seen.model, seen.coeffs = rs.distortion.none, [0.0] * 5
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.fmt, stream.bpp = kind[1], 0, uid, kind[2], kind[3]
    stream.width, stream.height, stream.fps, stream.intrinsics = *size, fps, seen
    return stream
