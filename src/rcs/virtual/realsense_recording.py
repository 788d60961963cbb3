"""Recordings of virtual RealSense cameras, which the vendor's library plays like a camera."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.extras import package_of
from rcs.hardware.realsense_software import SoftwareCamera
from rcs.robots.camera import ResolutionMode
from rcs.spatial import Intrinsics

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
    height, width = first[0].shape[:2]
    modes = {ResolutionMode(width, height, (fps,)): Intrinsics.of_matrix(matrix, (width, height))}
    camera = SoftwareCamera(rs, serial=serial, name=name, modes=modes, has_depth=first[1] is not None)
    recorder = rs.recorder(str(path), camera.device)
    written = recorder.query_sensors()
    for sensor in written:
        sensor.open(sensor.get_stream_profiles())
        sensor.start(lambda _: None)
    count, begin = 0, time.monotonic()
    for rgb, depth_mm, moment in (first, *remaining):
        count += 1
        camera.put(rgb, depth_mm, rate=fps, moment=moment, number=count)
        time.sleep(max(begin + count / fps - time.monotonic(), 0.0))  # the file has the times of arrival, too
    for sensor in written:
        sensor.stop()
        sensor.close()
    return count
