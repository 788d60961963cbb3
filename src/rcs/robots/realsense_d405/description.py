"""The figures of the Intel RealSense D405."""

from __future__ import annotations

from math import radians
from typing import Final

from rcs.robots.description import CameraDescription, Mount, ResolutionMode

REALSENSE_D405: Final = CameraDescription(
    name="realsense_d405",
    label="Intel RealSense D405",
    module=__name__,
    mjcf_file="realsense_d405.xml",
    base_body="camera",
    camera="color",
    # realsense2_description, _d405.urdf.xacro: the colour image comes from the left imager, 9 mm beside the centre and
    # 14.65 mm before the tripod hole, at half of the 42 mm height.
    mount_hole_in_optical=Mount(translation=(0.009, 0.021, -0.01465), quaternion=(0.5, -0.5, 0.5, 0.5)),
    # D400 series data sheet: formats of the D401 module. Rates are those that the device lists itself.
    modes=(
        ResolutionMode(1280, 720, (5, 15, 30)),
        ResolutionMode(848, 480, (5, 15, 30, 60, 90)),
        ResolutionMode(640, 480, (5, 15, 30, 60, 90)),
        ResolutionMode(640, 360, (5, 15, 30, 60, 90)),
        ResolutionMode(480, 270, (5, 15, 30, 60, 90)),
        ResolutionMode(424, 240, (5, 15, 30, 60, 90)),
    ),
    # D400 series data sheet: 87 x 58 degrees at 1280 x 720.
    fovy=radians(58.0),
    native_aspect=16 / 9,
    has_depth=True,
    # D400 series data sheet: ideal range 7 cm to 50 cm.
    depth_range=(0.07, 0.5),
    # Vendor's table of the nearest depth of the D401 module by format.
    min_depth=(
        (1280, 720, 0.100),
        (848, 480, 0.070),
        (640, 360, 0.055),
        (480, 270, 0.045),
        (424, 240, 0.040),
    ),
    # realsense-ros, _d405.urdf.xacro: offset of the second infrared camera.
    stereo_baseline=0.018,
    # D400 series data sheet: depth 87 x 58 degrees at 16:9.
    stereo_fovx=radians(87.0),
    sources=(
        "realsense2_description _d405.urdf.xacro (Apache-2.0): size, offsets, mass",
        "Intel RealSense D400 series data sheet 337029: field of view, formats, depth range",
        "profiles that librealsense lists for the device: frame rates of each format",
    ),
)
"""The Intel RealSense D405; colour and depth share one optical frame."""
