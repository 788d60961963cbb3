"""xArm7 with the Tilburg Hand: a D435i in front of the table, looking at the robot."""

from __future__ import annotations

from rcs.envs.task import Area
from rcs.robots.camera_mount import CameraMount, looking
from rcs.setups.lab import Lab, Stand

LAB = Lab(
    stands=(Stand(name="xarm7", arm="xarm7"),),
    end_effector="tilburg_hand",
    # The paper's 60 x 30 cm, the long side across the table.
    area=Area(center=(0.5, 0.0), size=(0.30, 0.60), large_center=(0.425, 0.0), large_size=(0.35, 0.70)),
    cameras={
        "front": CameraMount(camera="realsense_d435i", optical=looking((1.35, 0.0, 0.60), (0.40, 0.0, 0.12))),
    },
)
