"""The driver of webcams on USB ports, by OpenCV, and of cameras that stream JPEGs over HTTP."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcs.devices import CameraMode
from rcs.errors import require_fields
from rcs.hardware.driver import Driver
from rcs.hardware.v4l2 import CONTROLS
from rcs.hardware.video_camera import VideoCamera, pictures_at
from rcs.robots.camera import CameraDescription

OPTIONS = ("warm_up", "latency", "serial", *CONTROLS)
"""Options of a site: `warm_up` [s] drops the first pictures; `latency` [s] is the time that the fastest picture takes;
`serial` is the serial number that a camera at a URL must have; `exposure` [s] and others set controls."""


class WebcamDriver(Driver):
    """Driver of webcams. The address is a serial number, a place such as `usb:1-2.3`, or `http://HOST:PORT/PATH`."""

    def camera(
        self, address: str, about: CameraDescription, mode: CameraMode, options: Mapping[str, Any]
    ) -> VideoCamera:
        """Return a webcam."""
        require_fields("option of a webcam", options, OPTIONS)
        name = f"webcam {address}"
        return VideoCamera(name, mode, pictures_at(address, mode, options, what="webcam", mjpeg=True), options)
