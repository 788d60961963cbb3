"""The description of an optical tactile sensor: frozen figures of its gel, camera and lights.

The frame of the base body is the sensor's own: x out of the gel, z along the gel's long side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from rcs.errors import InvalidSetup
from rcs.robots.description import Description

_Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class TactileLight:
    """One light inside of the sensor."""

    position: _Vector
    """Position in the frame of the base body [m]."""
    color: _Vector
    """Red, green and blue, 0 … 1."""
    intensity: float
    """Brightness relative to the others."""


@dataclass(frozen=True, kw_only=True)
class TactileDescription(Description):
    """A sensor whose camera watches the back of an elastic gel."""

    gel_geom: str
    """Geom of the gel, which touches objects."""
    gel_center: _Vector
    """Foremost point of the gel, in the frame of the base body [m]."""
    gel_width: float
    """Length of the gel along y [m]."""
    gel_height: float
    """Length of the gel along z [m]."""
    gel_curvature_radius: float
    """Radius of the sphere of which the gel's surface is a part [m]."""
    gel_bulge: float
    """Height of the gel's centre above its corners; the sphere's cap is stretched to it [m]."""
    camera_position: _Vector
    """Position of the camera in the frame of the base body [m]; it looks along x with z up."""
    camera_yfov: float
    """Field of view of the camera along z [rad]."""
    camera_znear: float
    """Nearest distance that the camera sees [m]."""
    image_size: tuple[int, int]
    """Width (along y) and height (along z) of the image [px]."""
    rate: int
    """Highest rate at this size [frames/s]."""
    lights: tuple[TactileLight, ...]
    """Lights behind the gel."""
    force_range: tuple[float, float]
    """Contact forces from the first trace in the image to the deepest [N]."""
    max_indentation: float
    """Indentation of the gel at the largest force [m]."""
    noise_std: float
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
        lengths = (self.gel_width, self.gel_height, self.gel_curvature_radius, self.gel_bulge)
        positive = (*lengths, self.camera_znear, self.max_indentation, *self.image_size, self.rate)
        if not all(math.isfinite(value) and value > 0.0 for value in positive):
            raise InvalidSetup(f"{self.name}: lengths, image size and rate must be positive, got {positive}.")
        if math.hypot(self.gel_width, self.gel_height) / 2.0 >= self.gel_curvature_radius:
            raise InvalidSetup(f"{self.name}: the gel is larger than a sphere of {self.gel_curvature_radius} m.")
        if not 0.0 < self.camera_yfov < math.pi:
            raise InvalidSetup(f"{self.name}: camera_yfov is {self.camera_yfov} rad; valid is 0 .. pi.")
        if not self.lights or self.noise_std < 0.0:
            raise InvalidSetup(f"{self.name}: needs a light and a noise_std of 0 or more, got {self.noise_std}.")
        low, high = self.force_range
        if not 0.0 <= low < high:
            raise InvalidSetup(f"{self.name}: force_range {self.force_range} N must ascend from 0 or more.")
