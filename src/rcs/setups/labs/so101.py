"""SO101 with its own gripper: a webcam at the wrist, a D435 that sees the table diagonally."""

from __future__ import annotations

from rcs.envs.task import Area
from rcs.robots.camera_mount import CameraMount, looking
from rcs.robots.description import Mount
from rcs.setups.lab import Lab, Stand

LAB = Lab(
    stands=(Stand(name="so101", arm="so101"),),
    end_effector="so101_gripper",
    # The paper's 35 x 20 cm, with a smaller cuboid. At its far corners the gripper leans by up to 50 degrees.
    area=Area(center=(0.265, 0.0), size=(0.20, 0.35), object_scale=0.625, large_size=(0.20, 0.50)),
    cameras={
        # Where mujoco_menagerie's robotstudio_so101 has the camera on its published mount.
        "wrist": CameraMount(
            camera="usb_webcam",
            optical=Mount(
                translation=(0.0, 0.055, -0.045), quaternion=(0.9596616526574011, 0.0, 0.0, 0.281157451295294)
            ),
            on_gripper_of="so101",
        ),
        "diagonal": CameraMount(camera="realsense_d435", optical=looking((0.62, 0.52, 0.45), (0.16, 0.0, 0.05))),
    },
)
