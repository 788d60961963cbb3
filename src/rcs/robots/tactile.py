"""Optical tactile sensors: frozen figures of their gel, camera and lights, and those of the DIGIT.

The frame of the base body is the sensor's own: x out of the gel, z along the gel's long side.
"""

from __future__ import annotations

import math
from math import cos, radians, sin
from typing import Annotated, Final

from rcs_data.options import Meta, NotNegative, Positive, Record, Whole

from rcs.errors import InvalidSetup
from rcs.robots.description import Description

_Vector = tuple[float, float, float]


class TactileLight(Record):
    """One light inside of the sensor."""

    position: _Vector
    """Position in the frame of the base body [m]."""
    color: _Vector
    """Red, green and blue, 0 … 1; a weaker light has smaller numbers."""


class TactileDescription(Description):
    """A sensor whose camera watches the back of an elastic gel."""

    gel_geom: str
    """Geom of the gel, which touches objects."""
    gel_center: _Vector
    """Foremost point of the gel, in the frame of the base body [m]."""
    gel_width: Positive
    """Length of the gel along y [m]."""
    gel_height: Positive
    """Length of the gel along z [m]."""
    gel_curvature_radius: Positive
    """Radius of the sphere of which the gel's surface is a part [m]."""
    gel_bulge: Positive
    """Height of the gel's centre above its corners; the sphere's cap is stretched to it [m]."""
    camera_position: _Vector
    """Position of the camera in the frame of the base body [m]; it looks along x with z up."""
    camera_yfov: Annotated[float, Meta(gt=0, lt=math.pi)]
    """Field of view of the camera along z [rad]."""
    camera_znear: Positive
    """Nearest distance that the camera sees [m]."""
    image_size: tuple[Whole, Whole]
    """Width (along y) and height (along z) of the image [px]."""
    rate: Whole
    """Highest rate at this size [frames/s]."""
    lights: tuple[TactileLight, ...]
    """Lights behind the gel."""
    force_range: tuple[NotNegative, NotNegative]
    """Contact forces from the first trace in the image to the deepest [N]."""
    max_indentation: Positive
    """Indentation of the gel at the largest force [m]."""

    @property
    def frame_size(self) -> tuple[int, int]:
        """Width and height of a frame [px]: the camera lies on its side, so the gel's z is across."""
        return self.image_size[1], self.image_size[0]

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            InvalidSetup: A length is not positive, the field of view is outside of 0 .. pi, there is no light, or the
                force range does not ascend.
        """
        super().__post_init__()
        if math.hypot(self.gel_width, self.gel_height) / 2.0 >= self.gel_curvature_radius:
            raise InvalidSetup(f"{self.name}: the gel is larger than a sphere of {self.gel_curvature_radius} m.")
        if not self.lights:
            raise InvalidSetup(f"{self.name}: lights is (); at least one is needed.")
        low, high = self.force_range
        if low >= high:
            raise InvalidSetup(f"{self.name}: force_range {self.force_range} N must ascend.")


def _light(angle: float, color: tuple[float, float, float]) -> TactileLight:
    """Return a light on the ring behind the gel at an angle [degrees] from y towards z."""
    # tacto config_digit.yml: radius 20 mm in the plane x = 5 mm, around the gel's axis at z = 15 mm.
    y, z = 0.02 * cos(radians(angle)), 0.015 + 0.02 * sin(radians(angle))
    return TactileLight(position=(0.005, y, z), color=color)


DIGIT: Final = TactileDescription(
    name="digit",
    label="DIGIT",
    module=__name__,
    mjcf_file="digit.xml",
    base_body="digit",
    gel_geom="gel",
    # tacto config_digit.yml: gel, camera, lights, force.
    gel_center=(0.022, 0.0, 0.015),
    gel_width=0.02,
    gel_height=0.03,
    gel_curvature_radius=0.1,
    gel_bulge=0.005,
    camera_position=(0.0, 0.0, 0.015),
    camera_yfov=radians(60.0),
    camera_znear=0.001,
    # The sensor streams 320 x 240 px at 60 frames/s and lies on its side: upright, the image is 240 px wide.
    image_size=(240, 320),
    rate=60,
    lights=(_light(30.0, (1.0, 0.0, 0.0)), _light(150.0, (0.0, 1.0, 0.0)), _light(270.0, (0.0, 0.0, 1.0))),
    force_range=(0.0, 100.0),
    max_indentation=0.005,
    sources=(
        "tacto config_digit.yml (MIT): gel, camera, lights, force and indentation",
        "digit-interface: formats and rates of the stream",
        "Lambeta et al. 2020, DIGIT: a sensor weighs 20 g",
        "mujoco_menagerie ufactory_xarm7 hand (BSD-3-Clause): friction and stiffness, those of pads",
    ),
)
"""The DIGIT tactile sensor."""
