"""RealSense cameras on a network, as virtual ones are: their pictures, put into a software device.

The vendor's library lists no software device and has no pipeline for one, so that its sensors deliver to a syncer here.
A camera tells at its URL with `?about`, as JSON, its serial number and modes. Its stream is that of `HttpPictures`, but
a part is the pixels of a picture, not a JPEG: RGB, and then depth in millimetres (little-endian), row by row.
"""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Sequence
from http.client import HTTPConnection, HTTPException
from typing import Any

import numpy as np

from rcs.devices import CameraMode
from rcs.errors import DeviceFault
from rcs.hardware.pictures import MOST_BYTES, READ_LIMIT, HttpPictures, require_url
from rcs.hardware.realsense_software import SoftwareCamera
from rcs.robots.camera import ResolutionMode
from rcs.spatial import Intrinsics

RGB, RGBD = "rgb", "rgbd"
"""Values of `format` in the query of a stream: pixels without and with depth."""
_ENDED = 0.1
"""How soon the end of a stream is noticed [s]."""


class NetworkPipeline:
    """A camera at a URL, to be used like the library's pipeline and its profile."""

    def __init__(self, rs: Any, url: str, *, serial: str) -> None:
        """Ask the camera what it is, and make its software device.

        Args:
            rs: The vendor's library.
            url: Its URL.
            serial: Serial number that it must have; empty for any.

        Raises:
            DeviceFault: No camera answers, or it has another serial number.
        """
        told = _ask(url)
        try:
            self.serial: str = told["serial"]
            """The camera's serial number."""
            modes: dict[ResolutionMode, Intrinsics] = {}
            for mode in told["modes"]:
                width, height = mode["size"]
                seen = Intrinsics.of_matrix(mode["matrix"], (width, height), mode["distortion"])
                modes[ResolutionMode(width, height, tuple(mode["rates"]))] = seen
            self._camera = SoftwareCamera(
                rs, serial=self.serial, name=told["name"], modes=modes, has_depth=told["has_depth"]
            )
        except (KeyError, TypeError, ValueError) as err:
            raise DeviceFault(f"{url} is no RealSense: it answers {str(told)[:200]}") from err
        if serial and self.serial != serial:
            raise DeviceFault(f"another camera answers at {url}: its serial number is {self.serial!r}, not {serial!r}")
        self.device: Any = self._camera.device
        """The software device."""
        self._url = url
        self._syncer = rs.syncer()
        self._started: dict[Any, tuple[Any, Any]] = {}
        self._pictures: HttpPictures | None = None
        self._thread: threading.Thread | None = None
        self._fault: DeviceFault | None = None

    def start(self, streams: Sequence[tuple[Any, int, int, Any, int]]) -> NetworkPipeline:
        """Start streams, given by kind, width, height, format and rate, of which the first is that of colours.

        Raises:
            DeviceFault: The camera does not answer.
        """
        for sensor in self.device.query_sensors():
            for profile in sensor.get_stream_profiles():
                video = profile.as_video_stream_profile()
                mode = (profile.stream_type(), video.width(), video.height(), profile.format(), profile.fps())
                if mode in streams:
                    sensor.open(profile)
                    sensor.start(self._syncer)
                    self._started[profile.stream_type()] = (sensor, profile)
        _, width, height, _, rate = streams[0]
        has_depth = len(streams) == 2
        between = "&" if "?" in self._url else "?"
        url = f"{self._url}{between}format={RGBD if has_depth else RGB}"
        self._pictures = HttpPictures(url, CameraMode(width, height, rate, has_depth), serial=self.serial)
        self._pictures.open()
        self._thread = threading.Thread(
            target=self._feed, args=(self._pictures, (height, width), rate, has_depth), name=self._url, daemon=True
        )
        self._thread.start()
        return self

    def get_device(self) -> Any:
        """Return the software device."""
        return self.device

    def get_stream(self, kind: Any) -> Any:
        """Return the profile of a stream that was started."""
        return self._started[kind][1]

    def wait_for_frames(self, limit: int) -> Any:
        """Wait for a set of pictures.

        Args:
            limit: Longest wait [ms].

        Raises:
            RuntimeError: There is none, as from the library.
        """
        until = time.monotonic() + 1e-3 * limit
        while True:
            left = until - time.monotonic()
            has_come, frames = self._syncer.try_wait_for_frames(int(1e3 * max(min(left, _ENDED), 0.001)))
            if has_come:
                return frames
            if self._fault is not None:
                raise RuntimeError(str(self._fault)) from self._fault
            if left <= 0:
                raise RuntimeError(f"Frame didn't arrive within {limit}")

    def poll_for_frames(self) -> Any:
        """Return the set that has come, or an empty one."""
        return self._syncer.poll_for_frames()

    def stop(self) -> None:
        """Disconnect, and stop the streams."""
        if self._pictures is not None:
            self._pictures.interrupt()
        if self._thread is not None:
            self._thread.join()
        for sensor, _ in self._started.values():
            sensor.stop()
            sensor.close()
        self._started.clear()

    def _feed(self, pictures: HttpPictures, shape: tuple[int, int], rate: int, has_depth: bool) -> None:
        """Put what comes into the software device, until the connection ends."""
        height, width = shape
        colours = 3 * height * width
        length = colours + (2 * height * width if has_depth else 0)
        try:
            while True:
                picture = pictures.newest()
                if len(picture.content) != length or math.isnan(picture.device_time):
                    continue  # it is torn
                rgb = np.frombuffer(picture.content, np.uint8, colours).reshape(height, width, 3)
                depth = np.frombuffer(picture.content, "<u2", offset=colours).reshape(shape) if has_depth else None
                self._camera.put(rgb, depth, rate=rate, moment=picture.device_time, number=picture.number + 1)
        except DeviceFault as err:
            self._fault = err
        finally:
            pictures.close()


def _ask(url: str) -> dict[str, Any]:
    """Return what a camera tells about itself."""
    parts = require_url(url)
    connection = HTTPConnection(parts.hostname or "", parts.port or 80, timeout=READ_LIMIT)
    try:
        connection.request("GET", f"{parts.path or '/'}?{parts.query + '&' if parts.query else ''}about")
        told = json.loads(connection.getresponse().read(MOST_BYTES))
    except (OSError, HTTPException, ValueError) as err:
        raise DeviceFault(f"no RealSense answers at {url}: {err}") from err
    finally:
        connection.close()
    if not isinstance(told, dict):
        raise DeviceFault(f"{url} is no RealSense: it answers {str(told)[:200]}")
    return told
