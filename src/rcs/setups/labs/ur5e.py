"""UR5e with Robotiq 2F-85: a D405 at the wrist, a second one above the table."""

from __future__ import annotations

from math import sqrt

from rcs.envs.task import Area
from rcs.robots.camera_mount import CameraMount, looking
from rcs.robots.description import Mount
from rcs.setups.lab import Lab, Stand

LAB = Lab(
    # Its home pose points along the base's y axis: a quarter turn makes that the scene's x.
    stands=(Stand(name="ur5e", arm="ur5e", base_in_scene=Mount(quaternion=(0.0, 0.0, -sqrt(0.5), sqrt(0.5)))),),
    end_effector="robotiq_2f85",
    area=Area(center=(0.5, 0.0), size=(0.50, 0.50), large_size=(0.50, 0.80)),
    cameras={
        "wrist": CameraMount(
            camera="realsense_d405",
            optical=looking((0.085, 0.0, 0.07), (0.0, 0.0, 0.22), up=(1.0, 0.0, 0.0)),
            on_gripper_of="ur5e",
        ),
        "overhead": CameraMount(
            camera="realsense_d405", optical=looking((0.50, 0.0, 1.05), (0.50, 0.0, 0.0), up=(1.0, 0.0, 0.0))
        ),
    },
)
