"""Pictures of a camera on a USB port, by OpenCV on V4L2."""

from __future__ import annotations

import errno
import math
import os
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from rcs.devices import CameraMode
from rcs.errors import DeviceFault, InvalidSetup
from rcs.extras import package_of
from rcs.hardware import v4l2
from rcs.hardware.device_clock import DeviceClock
from rcs.hardware.pictures import Picture
from rcs.hardware.programs import holders
from rcs.hardware.usb import Plug, UsbDevice, find, usb_devices

COMPRESSED_BITS, RAW_BITS = 4, 16
"""Bits per pixel of pictures as MJPG (our estimate, at good quality) and as YUYV."""
MOST_WAITING = 10
"""Number of pictures that wait in OpenCV's buffers at most."""


class V4l2Pictures:
    """The stream of a camera that the kernel knows."""

    def __init__(
        self,
        address: str,
        mode: CameraMode,
        controls: Mapping[str, Any],
        *,
        what: str,
        latency: float = 0.0,
        mjpeg: bool = True,
        model: str = "",
    ) -> None:
        """Open nothing yet.

        Args:
            address: Serial number, or `usb:` and a place such as `usb:1-2.3`.
            mode: Size and rate.
            controls: Values of `rcs.hardware.v4l2.CONTROLS`.
            what: Kind of camera, "webcam" or "DIGIT", in messages; in small letters, the extra that it needs.
            latency: Time from a picture to its time stamp by the kernel [s].
            mjpeg: Whether the camera compresses its pictures.
            model: Product name that it must have; empty for any.
        """
        self._address, self._mode, self._controls, self._what = address, mode, dict(controls), what
        self._latency, self._format, self._model = latency, "MJPG" if mjpeg else "YUYV", model
        self._capture: Any = None
        self._number = -1
        self.serial = ""
        self.clock: DeviceClock | None = None

    def plug(self) -> Plug:
        """Return the device and what its pictures need.

        Raises:
            InvalidSetup: It is not plugged in.
        """
        bits = COMPRESSED_BITS if self._format == "MJPG" else RAW_BITS
        needs = self._mode.width * self._mode.height * self._mode.fps * bits / 1e6
        return Plug(device=self._device(), needs=needs)

    def open(self) -> None:
        """Find the camera, start its stream, and set its controls.

        Raises:
            InvalidSetup: It is not plugged in, does not offer the mode, or lacks a control.
            DeviceFault: It cannot be opened, and the message names who holds it, or what permits it; or it is another
                one than before.
        """
        self.close()
        cv2 = package_of(self._what.lower(), "cv2", "A camera on a USB port needs")
        device = self._device()
        if self.serial and device.serial != self.serial:
            raise DeviceFault(
                f"another camera answers at {self._address}: its serial number is {device.serial!r}, not "
                f"{self.serial!r}"
            )
        self.serial = device.serial
        path = f"/dev/{next(node for node in device.nodes if node.startswith('video'))}"
        file = self._file(path)
        try:
            self._require_mode(file)
            self._start(cv2, device, path)
            # Only now: it would also change the pictures of another program, which has the stream.
            v4l2.set_controls(file, f"{self._what} {self._address}", self._controls)
        except BaseException:
            self.close()
            raise
        finally:
            os.close(file)

    def _start(self, cv2: Any, device: UsbDevice, path: str) -> None:
        """Start the stream in the mode and format."""
        os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")  # [s]; OpenCV waits ten otherwise
        mode, form = self._mode, cv2.VideoWriter.fourcc(*self._format)
        capture = cv2.VideoCapture(path, cv2.CAP_V4L2)
        capture.set(cv2.CAP_PROP_FOURCC, form)
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, mode.width)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, mode.height)
        capture.set(cv2.CAP_PROP_FPS, mode.fps)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 2)
        if self._format == "MJPG":
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)  # damaged pictures are found where they are decoded
        wants = (mode.width, mode.height, float(mode.fps))
        has = (
            int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
            capture.get(cv2.CAP_PROP_FPS),
        )
        if capture.isOpened() and (gives := int(capture.get(cv2.CAP_PROP_FOURCC))) != form:
            capture.release()
            raise InvalidSetup(
                f"{device} does not offer {mode.width} x {mode.height} at {mode.fps:g} Hz as {self._format}; it gives "
                f"{gives.to_bytes(4, 'little').decode('latin-1')}. Use a {self._what} that has {self._format}."
            )
        if not capture.isOpened() or has[:2] != wants[:2] or abs(has[2] - wants[2]) > 0.5:
            capture.release()
            held = ", ".join(holders(path))
            raise DeviceFault(
                f"{device} does not start in {mode.width} x {mode.height} at {mode.fps:g} Hz as {self._format}; it "
                f"gives {has[0]} x {has[1]} at {has[2]:g} Hz. {f'It is held by {held}.' if held else ''}".strip()
            )
        self._capture, self._cv2 = capture, cv2

    def newest(self) -> Picture:
        """Wait for a picture that was not returned before, skip older ones, and return it.

        Raises:
            DeviceFault: The camera gives none.
        """
        if self._capture is None:
            raise DeviceFault(f"the {self._what} {self._address} is not open")
        period, cv2 = 1.0 / self._mode.fps, self._cv2
        for _ in range(MOST_WAITING + 1):
            begin = time.monotonic()
            if not self._capture.grab():
                raise DeviceFault(f"the {self._what} {self._address} gives no picture; is its cable out?")
            self._number += 1
            if time.monotonic() - begin > 0.25 * period:  # else it was waiting in a buffer
                break
        now = time.monotonic()
        stamp = 1e-3 * self._capture.get(cv2.CAP_PROP_POS_MSEC)
        # The kernel stamps with the monotonic clock, unless an old driver uses another one.
        taken = stamp if 0.0 <= now - stamp < 2.0 else now
        ok, pixels = self._capture.retrieve()
        if not ok:
            raise DeviceFault(f"a picture of the {self._what} {self._address} cannot be decoded")
        device_time = stamp if taken == stamp else math.nan
        about: Any = {"number": self._number, "time": taken - self._latency, "device_time": device_time}
        if self._format == "MJPG":
            return Picture(content=np.ascontiguousarray(pixels).tobytes().rstrip(b"\0"), **about)
        return Picture(rgb=np.ascontiguousarray(pixels[..., ::-1]), **about)

    def close(self) -> None:
        """Disconnect; closing twice is harmless."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def _device(self) -> UsbDevice:
        cameras = [one for one in usb_devices() if any(node.startswith("video") for node in one.nodes)]
        if self._model:
            cameras = [one for one in cameras if one.product == self._model]
        return find(self._address, cameras, self._what)

    def _file(self, path: str) -> int:
        """Open the camera's file."""
        try:
            return os.open(path, os.O_RDWR | os.O_NONBLOCK)
        except OSError as err:
            remedy = "check its cable"
            if isinstance(err, PermissionError):
                remedy = "add yourself to its group: sudo usermod -aG video $USER"
            elif err.errno == errno.EBUSY:
                remedy = f"it is held by {', '.join(holders(path)) or 'a program of another user'}"
            raise DeviceFault(f"{path} cannot be opened: {err.strerror}; {remedy}") from err

    def _require_mode(self, file: int) -> None:
        """Check that the mode is offered."""
        mode, offered = self._mode, v4l2.modes(file, self._format)
        fits = [rates for width, height, rates in offered if (width, height) == (mode.width, mode.height)]
        # A size without a list of rates has all in a range; the one that comes of it is looked at once it streams.
        if offered and not any(not rates or any(abs(rate - mode.fps) < 0.5 for rate in rates) for rates in fits):
            each = "; ".join(f"{w}x{h} at {', '.join(f'{r:g}' for r in rates) or 'any'} Hz" for w, h, rates in offered)
            raise InvalidSetup(
                f"The {self._what} {self._address} does not offer {mode.width}x{mode.height} at {mode.fps:g} Hz as "
                f"{self._format}; it has {each}."
            )
