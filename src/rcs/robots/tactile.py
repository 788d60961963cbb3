"""The description of an optical tactile sensor: frozen figures of its gel, camera and lights.

The frame of the base body is the sensor's own: x out of the gel, z along the gel's long side.
"""

from __future__ import annotations

import math
from typing import Annotated

from rcs_data.record import Meta, NotNegative, Positive, Record, Whole

from rcs.errors import InvalidSetup
from rcs.robots.description import Description

_Vector = tuple[float, float, float]


class TactileLight(Record):
    """One light inside of the sensor."""

    position: _Vector
    """Position in the frame of the base body [m]."""
    color: _Vector
    """Red, green and blue, 0 … 1."""
    intensity: float
    """Brightness relative to the others."""


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
    noise_std: NotNegative
    """Standard deviation of the image's noise [of 255]."""

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
