"""The figures of built-in cameras."""

from __future__ import annotations

from dataclasses import replace
from math import atan, pi, radians, tan
from typing import Final

from rcs.robots.camera import CameraDescription, ResolutionMode
from rcs.robots.mount import Mount

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

# A board with a small lens as sold by InnoMaker and others: such cameras are sold with many lenses and without a data
# sheet that all agree on. All figures are assumptions, chosen as typical; calibrate a real one.
USB_WEBCAM: Final = CameraDescription(
    name="usb_webcam",
    label="USB webcam",
    module=__name__,
    mjcf_file="usb_webcam.xml",
    base_body="camera",
    camera="color",
    # Assumption: a holder of 32 x 32 x 12 mm with the hole in the middle of its underside.
    mount_hole_in_optical=Mount(translation=(0.0, 0.016, -0.018), quaternion=(0.5, -0.5, 0.5, 0.5)),
    # Nearly all of them offer these as MJPG: the intervals of a common UVC descriptor, 1/30 to 1/5 s.
    modes=tuple(
        ResolutionMode(width, height, (5, 10, 15, 20, 25, 30))
        for width, height in ((1280, 720), (640, 480), (640, 360), (320, 240))
    ),
    # Assumption: 70 degrees across at 16:9, a lens without noticeable distortion.
    fovy=2.0 * atan(9 / 16 * tan(radians(70.0) / 2)),
    native_aspect=16 / 9,
    has_depth=False,
    depth_range=(0.0, 0.0),
    min_depth=(),
    # With auto exposure priority a UVC camera lengthens its exposure in low light, and its rate rolls. Microsoft's
    # documentation of that control has 25 frames/s and 40 ms as its example; assumption: a lab is no darker.
    longest_exposure=0.040,
    sources=("assumptions: size, mass, field of view and formats that are typical of 720p USB board cameras",),
)
"""A USB camera without depth, 720p at up to 30 frames/s; in a lab's light, its frames come 33 to 40 ms apart."""

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
