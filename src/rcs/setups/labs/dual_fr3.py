"""Two FR3 with Franka Hands side by side, facing the same way, and a D435 in front of them."""

from __future__ import annotations

from rcs.envs.task import Area
from rcs.robots.camera_mount import CameraMount, looking
from rcs.robots.description import Mount
from rcs.setups.lab import Lab, Stand

DISTANCE = 0.70
"""Between the two bases [m]: far enough that the elbows do not meet, near enough that the workspaces do."""

LAB = Lab(
    stands=(
        Stand(name="left", arm="fr3", base_in_scene=Mount(translation=(0.0, DISTANCE / 2, 0.0))),
        Stand(name="right", arm="fr3", base_in_scene=Mount(translation=(0.0, -DISTANCE / 2, 0.0))),
    ),
    end_effector="franka_hand",
    area=Area(center=(0.5, 0.0), size=(0.16, 0.10)),
    cameras={
        "front": CameraMount(camera="realsense_d435", optical=looking((1.45, 0.0, 0.75), (0.40, 0.0, 0.10))),
        "left_wrist": CameraMount(
            camera="realsense_d405",
            optical=looking((0.070, 0.0, 0.045), (0.0, 0.0, 0.17), up=(1.0, 0.0, 0.0)),
            on_gripper_of="left",
        ),
        "right_wrist": CameraMount(
            camera="realsense_d405",
            optical=looking((0.070, 0.0, 0.045), (0.0, 0.0, 0.17), up=(1.0, 0.0, 0.0)),
            on_gripper_of="right",
        ),
    },
)
