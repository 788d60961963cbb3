"""The figures of the Intel RealSense D435."""

from __future__ import annotations

from math import radians
from typing import Final

from rcs.robots.description import CameraDescription, Mount, ResolutionMode

REALSENSE_D435: Final = CameraDescription(
    name="realsense_d435",
    label="Intel RealSense D435",
    module=__name__,
    mjcf_file="realsense_d435.xml",
    base_body="camera",
    camera="color",
    # realsense2_description, _d435.urdf.xacro: the colour sensor sits 15 mm left of the depth frame, which is 17.5 mm
    # beside the centre and 14.9 mm before the tripod hole, at half of the 25 mm height.
    mount_hole_in_optical=Mount(translation=(0.0325, 0.0125, -0.0149), quaternion=(0.5, -0.5, 0.5, 0.5)),
    # D400 series data sheet: formats of the colour sensor. Rates are those that the device lists itself.
    modes=(
        ResolutionMode(1920, 1080, (6, 15, 30)),
        ResolutionMode(1280, 720, (6, 15, 30)),
        ResolutionMode(960, 540, (6, 15, 30, 60)),
        ResolutionMode(848, 480, (6, 15, 30, 60)),
        ResolutionMode(640, 480, (6, 15, 30, 60)),
        ResolutionMode(640, 360, (6, 15, 30, 60)),
        ResolutionMode(424, 240, (6, 15, 30, 60)),
        ResolutionMode(320, 240, (6, 30, 60)),
        ResolutionMode(320, 180, (6, 30, 60)),
    ),
    # D400 series data sheet: colour 69.4 x 42.5 degrees, +-3. Calibrated cameras report fy = 606 .. 617 px at
    # 640 x 480; this gives 617 px.
    fovy=radians(42.5),
    native_aspect=16 / 9,
    has_depth=True,
    # D400 series data sheet: useful range 0.3 m to 3 m.
    depth_range=(0.3, 3.0),
    # D400 series data sheet: nearest depth of the D430 module by format.
    min_depth=(
        (1280, 720, 0.280),
        (848, 480, 0.195),
        (640, 480, 0.175),
        (640, 360, 0.150),
        (480, 270, 0.120),
        (424, 240, 0.105),
    ),
    # realsense-ros, _d435.urdf.xacro: offset of the second infrared camera.
    stereo_baseline=0.050,
    # D400 series data sheet: depth 87 x 58 degrees at 16:9.
    stereo_fovx=radians(87.0),
    sources=(
        "realsense2_description _d435.urdf.xacro (Apache-2.0): size, offsets, mass",
        "Intel RealSense D400 series data sheet 337029: fields of view, formats, depth range",
        "rs-enumerate-devices (librealsense): frame rates of each colour format",
    ),
)
"""The Intel RealSense D435; the description is of its colour sensor."""
