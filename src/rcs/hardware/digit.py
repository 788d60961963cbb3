"""The driver of DIGIT tactile sensors, which are webcams with lights."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcs.devices import CameraMode
from rcs.errors import InvalidSetup, require_fields
from rcs.hardware.driver import Driver
from rcs.hardware.video_camera import VideoCamera, pictures_at
from rcs.robots.tactile import TactileDescription

MODEL = "DIGIT"
"""Product name of the sensor on the USB bus."""
BRIGHTEST = 15
"""Largest intensity of a light; digit-interface 0.2.1, documentation of `set_intensity`."""


class DigitDriver(Driver):
    """Driver of DIGITs. The address is a serial number such as `D20001`, a place, or a URL, as for webcams.

    The option `lights` is the intensity of red, green and blue, 0 to 15, by default 15 for each; `latency`, `warm_up`
    and `serial` are those of webcams.
    """

    def tactile(
        self, address: str, about: TactileDescription, mode: CameraMode, options: Mapping[str, Any]
    ) -> VideoCamera:
        """Return the camera of a sensor."""
        require_fields("option of a DIGIT", options, ("lights", "latency", "warm_up", "serial"))
        given = {name: value for name, value in options.items() if name != "lights"}
        if "://" not in address:
            given["lights"] = _packed(options.get("lights", (BRIGHTEST,) * 3))
        elif "lights" in options:
            raise InvalidSetup(f"The lights of a DIGIT at {address} are set there; leave out the option lights.")
        pictures = pictures_at(address, mode, given, what="DIGIT", mjpeg=False, model=MODEL)
        return VideoCamera(f"DIGIT {address}", mode, pictures, options)


def _packed(lights: Any) -> int:
    """Return the value of the control that sets the lights: four bits each for red, green and blue."""
    try:
        red, green, blue = lights
    except (TypeError, ValueError):
        red = green = blue = -1
    if not all(isinstance(one, int) and 0 <= one <= BRIGHTEST for one in (red, green, blue)):
        raise InvalidSetup(f"lights is {lights!r}; valid are three integers, red, green and blue, 0 to {BRIGHTEST}.")
    return red << 8 | green << 4 | blue
