"""The figures of the DIGIT tactile sensor."""

from __future__ import annotations

from math import cos, radians, sin
from typing import Final

from rcs.robots.tactile import TactileDescription, TactileLight


def _light(angle: float, color: tuple[float, float, float]) -> TactileLight:
    """Return a light on the ring behind the gel at an angle [degrees] from y towards z."""
    # tacto config_digit.yml: radius 20 mm in the plane x = 5 mm, around the gel's axis at z = 15 mm; intensity 1.
    y, z = 0.02 * cos(radians(angle)), 0.015 + 0.02 * sin(radians(angle))
    return TactileLight(position=(0.005, y, z), color=color, intensity=1.0)


DIGIT: Final = TactileDescription(
    name="digit",
    label="DIGIT",
    module=__name__,
    mjcf_file="digit.xml",
    base_body="digit",
    gel_geom="gel",
    # tacto config_digit.yml: gel, camera, lights, noise, force.
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
    noise_std=7.0,
    sources=(
        "tacto config_digit.yml (MIT): gel, camera, lights, noise, force and indentation",
        "digit-interface: formats and rates of the stream",
        "Lambeta et al. 2020, DIGIT: a sensor weighs 20 g",
        "mujoco_menagerie ufactory_xarm7 hand (BSD-3-Clause): friction and stiffness, those of pads",
    ),
)
"""The DIGIT tactile sensor."""
