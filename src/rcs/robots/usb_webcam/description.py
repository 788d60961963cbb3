"""The figures of a plain USB camera, a board with a small lens as sold by InnoMaker and others.

Such cameras are sold with many lenses and without a data sheet that all agree on. All figures are assumptions, chosen
as typical; calibrate a real one.
"""

from __future__ import annotations

from math import atan, radians, tan
from typing import Final

from rcs.robots.description import CameraDescription, Mount

USB_WEBCAM: Final = CameraDescription(
    name="usb_webcam",
    label="USB webcam",
    module=__name__,
    mjcf_file="usb_webcam.xml",
    base_body="camera",
    camera="color",
    # Assumption: a holder of 32 x 32 x 12 mm with the hole in the middle of its underside.
    mount_hole_in_optical=Mount(translation=(0.0, 0.016, -0.018), quaternion=(0.5, -0.5, 0.5, 0.5)),
    # What nearly all of them offer as MJPG; a rolling shutter reads the rows one after the other.
    resolutions=((1280, 720, 30), (640, 480, 30), (640, 360, 30), (320, 240, 30)),
    # Assumption: 70 degrees across at 16:9, a lens without noticeable distortion.
    fovy=2.0 * atan(9 / 16 * tan(radians(70.0) / 2)),
    native_aspect=16 / 9,
    has_depth=False,
    depth_range=(0.0, 0.0),
    min_depth=(),
    sources=("assumptions: size, mass, field of view and formats that are typical of 720p USB board cameras",),
)
"""A USB camera without depth, 720p at 30 frames/s."""
