"""The figures of a plain USB camera, a board with a small lens as sold by InnoMaker and others.

Such cameras are sold with many lenses and without a data sheet that all agree on. All figures are assumptions, chosen
as typical; calibrate a real one.
"""

from __future__ import annotations

from math import atan, radians, tan
from typing import Final

from rcs.robots.description import CameraDescription, Mount, ResolutionMode

USB_WEBCAM: Final = CameraDescription(
    name="usb_webcam",
    label="USB webcam",
    module=__name__,
    mjcf_file="usb_webcam.xml",
    base_body="camera",
    camera="color",
    # Assumption: a holder of 32 x 32 x 12 mm with the hole in the middle of its underside.
    mount_hole_in_optical=Mount(translation=(0.0, 0.016, -0.018), quaternion=(0.5, -0.5, 0.5, 0.5)),
    # What nearly all of them offer as MJPG: the intervals of a common UVC descriptor, 1/30 to 1/5 s.
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
