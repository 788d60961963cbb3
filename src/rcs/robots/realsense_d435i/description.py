"""The figures of the Intel RealSense D435i."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from rcs.robots.realsense_d435.description import REALSENSE_D435

# D400 series data sheet: housing, colour sensor, depth module and formats are those of the D435. The mass is that of
# mujoco_menagerie realsense_d435i, 72 g. The inertial measurement unit is not described.
REALSENSE_D435I: Final = replace(
    REALSENSE_D435,
    name="realsense_d435i",
    label="Intel RealSense D435i",
    module=__name__,
    mjcf_file="realsense_d435i.xml",
    sources=(*REALSENSE_D435.sources, "mujoco_menagerie realsense_d435i (Apache-2.0): mass and size"),
)
"""The Intel RealSense D435i; the description is of its colour sensor."""
