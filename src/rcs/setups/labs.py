"""The labs of the paper. Camera poses are ours: the paper does not print them."""

from __future__ import annotations

from math import sqrt
from pathlib import Path
from typing import Final

from rcs.envs.task import Area
from rcs.robots.camera import CameraMount, looking
from rcs.robots.mount import Mount
from rcs.setups.calibration import calibrated
from rcs.setups.lab import Lab, Stand

FR3: Final = calibrated(
    Lab(
        about="FR3 with Franka Hand: a D405 at the wrist, a D435 beside the table (paper, section on setups).",
        stands=(Stand(name="fr3", arm="fr3"),),
        end_effector="franka_hand",
        area=Area(center=(0.5, 0.0), size=(0.30, 0.40), large_size=(0.40, 0.70)),
        cameras={
            # In front of the hand, its body clear of the fingers, tilted to see both pads and what is below them.
            "wrist": CameraMount(camera="realsense_d405", optical=Mount(), on_gripper_of="fr3"),
            # Where a second robot would hold it: beside the workspace, looking across it.
            "side": CameraMount(camera="realsense_d435", optical=Mount()),
        },
    ),
    Path(__file__).with_name("fr3_cameras.json"),
)
"""Camera poses and intrinsics are in `fr3_cameras.json`, whose place a calibration of a real lab takes."""

_DISTANCE = 0.70
"""Between the two bases [m]: far enough that the elbows do not meet, near enough that the workspaces do."""

DUAL_FR3: Final = Lab(
    about="Two FR3 with Franka Hands side by side, facing the same way, and a D435 in front of them.",
    stands=(
        Stand(name="left", arm="fr3", base_in_scene=Mount(translation=(0.0, _DISTANCE / 2, 0.0))),
        Stand(name="right", arm="fr3", base_in_scene=Mount(translation=(0.0, -_DISTANCE / 2, 0.0))),
    ),
    end_effector="franka_hand",
    area=Area(center=(0.5, 0.0), size=(0.16, 0.10)),
    cameras={
        "front": CameraMount(camera="realsense_d435", optical=looking((1.45, 0.0, 0.75), (0.40, 0.0, 0.10))),
        **{
            f"{arm}_wrist": CameraMount(
                camera="realsense_d405",
                optical=looking((0.070, 0.0, 0.045), (0.0, 0.0, 0.17), up=(1.0, 0.0, 0.0)),
                on_gripper_of=arm,
            )
            for arm in ("left", "right")
        },
    },
)

SO101: Final = Lab(
    about="SO101 with its own gripper: a webcam at the wrist, a D435 that sees the table diagonally.",
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

UR5E: Final = Lab(
    about="UR5e with Robotiq 2F-85: a D405 at the wrist, a second one above the table.",
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

XARM7: Final = Lab(
    about="xArm7 with the Tilburg Hand: a D435i in front of the table, looking at the robot.",
    stands=(Stand(name="xarm7", arm="xarm7"),),
    end_effector="tilburg_hand",
    # The paper's 60 x 30 cm, the long side across the table.
    area=Area(center=(0.5, 0.0), size=(0.30, 0.60), large_center=(0.425, 0.0), large_size=(0.35, 0.70)),
    cameras={"front": CameraMount(camera="realsense_d435i", optical=looking((1.35, 0.0, 0.60), (0.40, 0.0, 0.12)))},
)
