"""A camera whose pictures come from a stream: sharp where the driver is, the same for webcams and tactile sensors."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import simplejpeg

from rcs.devices import Camera, CameraMode, Frame
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.pictures import READ_LIMIT, HttpPictures, Pictures
from rcs.hardware.usb import Plug
from rcs.hardware.v4l2_pictures import V4l2Pictures

STEADY, LONGEST_SETTLING = 10, 3.0
"""Times are right from this number of pictures on after the last one that was sooner than those before it; and how long
to wait for that at most [s]."""
LONGEST_WARM_UP = 5.0
"""Longest time for which pictures are dropped after opening [s]."""


class VideoCamera(Camera):
    """A camera on a USB port (V4L2) or on a network."""

    def __init__(self, name: str, mode: CameraMode, pictures: Pictures, options: Mapping[str, Any]) -> None:
        """Open nothing yet.

        Args:
            name: Name in messages.
            mode: Size and rate, without depth.
            pictures: Where the pictures come from.
            options: Options of the site, of which `warm_up` counts here; the others are kept with recordings.

        Raises:
            InvalidSetup: The mode has depth, or `warm_up` is not valid.
        """
        if mode.has_depth:
            raise InvalidSetup(f"{name} has no depth; use depth=False, or a depth camera.")
        self._warm_up = seconds("warm_up", options.get("warm_up", 0.0), LONGEST_WARM_UP)
        super().__init__(name, mode)
        self._pictures = pictures
        self._options = dict(options)
        self._is_new = False  # opened, and not read yet

    @property
    def about(self) -> dict[str, Any]:
        """Facts for recordings: serial number, as soon as it is known, and options."""
        return {"serial": self._pictures.serial, "options": self._options}

    def plug(self) -> Plug | None:
        """Return its place on a USB bus; None on a network."""
        return self._pictures.plug() if isinstance(self._pictures, V4l2Pictures) else None

    def _open(self) -> None:
        self._start()
        self._is_new = True

    def _start(self) -> None:
        """Connect, and drop the first pictures: they come late, which would make their times wrong."""
        self._pictures.open()
        begin, count = time.monotonic(), 0
        since = 0.0
        while since < max(self._warm_up, LONGEST_SETTLING):
            picture = self._pictures.newest()
            since, count = time.monotonic() - begin, count + 1
            clock = self._pictures.clock
            if clock is not None and math.isfinite(picture.device_time):
                is_steady = clock.steady >= STEADY
            else:
                is_steady = count >= 3 and (count >= STEADY or since > 0.5)
            if is_steady and since >= self._warm_up:
                return

    def _read(self) -> Frame:
        self._is_new = False
        until = time.monotonic() + READ_LIMIT
        while True:
            picture = self._pictures.newest()
            rgb = picture.rgb
            if rgb is None:
                try:
                    rgb = simplejpeg.decode_jpeg(picture.content, colorspace="RGB", strict=True)
                except ValueError as err:  # bytes are missing: the picture is torn
                    if time.monotonic() > until:
                        raise DeviceFault(f"all pictures for {READ_LIMIT:g} s were damaged: {err}") from err
                    continue
            return Frame(rgb, number=picture.number, time=picture.time, device_time=picture.device_time)

    def _recover(self) -> None:
        if not self._is_new:  # else the fault is from before this connection
            self._start()

    def _close(self) -> None:
        self._pictures.close()


def pictures_at(
    address: str, mode: CameraMode, options: Mapping[str, Any], *, what: str, mjpeg: bool, model: str = ""
) -> Pictures:
    """Return the source of pictures at an address.

    Args:
        address: Serial number, `usb:` and a place, or a URL.
        mode: Size and rate.
        options: `serial` and `latency` of a camera on a network, controls of one on a USB port.
        what: Kind of camera in messages, such as "webcam".
        mjpeg: Whether a camera on a USB port compresses its pictures.
        model: Product name that it must have; empty for any.

    Raises:
        InvalidSetup: The address or an option is not valid.
    """
    latency = seconds("latency", options.get("latency", 0.0), 1.0)
    controls = {name: value for name, value in options.items() if name not in ("latency", "serial", "warm_up")}
    if "://" not in address:
        if "serial" in options:
            raise InvalidSetup(f"The serial number of a {what} on a USB port is its address, not an option.")
        return V4l2Pictures(address, mode, controls, what=what, latency=latency, mjpeg=mjpeg, model=model)
    if controls:
        raise InvalidSetup(f"The options {sorted(controls)} are for a USB port; set them on the camera at {address}.")
    return HttpPictures(address, mode, serial=str(options.get("serial", "")), latency=latency)


def seconds(name: str, given: Any, most: float) -> float:
    """Return an option that is a time [s].

    Raises:
        InvalidSetup: It is not a number between 0 and `most`.
    """
    if (
        isinstance(given, bool)
        or not isinstance(given, int | float)
        or not (math.isfinite(given) and 0 <= given <= most)
    ):
        raise InvalidSetup(f"{name} is {given!r} s; valid is 0 to {most:g}.")
    return float(given)
