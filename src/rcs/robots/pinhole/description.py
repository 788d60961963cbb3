"""A camera with only a known field of view, such as one in a robot's model file."""

from __future__ import annotations

from math import pi
from typing import Final

from rcs.robots.description import CameraDescription, Mount, ResolutionMode

RATES: Final = (5, 10, 15, 20, 25, 30, 50, 60)
"""Usual frame rates [frames/s]."""

PINHOLE: Final = CameraDescription(
    name="pinhole",
    label="Ideal camera",
    module=__name__,
    mjcf_file="pinhole.xml",
    base_body="optical",
    camera="camera",
    mount_hole_in_optical=Mount(),
    # Not a device: limited only by the renderer.
    modes=(ResolutionMode(4096, 4096, RATES),),
    fovy=pi / 4,
    native_aspect=4096.0,
    has_depth=True,
    depth_range=(0.005, 20.0),
    min_depth=(),
    sources=("MuJoCo's default field of view, 45 degrees",),
)
"""An ideal camera; set field of view and format with `dataclasses.replace`."""
