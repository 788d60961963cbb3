"""FR3 with Franka Hand: a D405 at the wrist, a D435 beside the table (paper, section on setups).

Camera poses and intrinsics are in `fr3_cameras.json`, which a calibration of a real lab takes the place of.
"""

from __future__ import annotations

from pathlib import Path

from rcs.envs.task import Area
from rcs.robots.camera_mount import CameraMount
from rcs.robots.description import Mount
from rcs.setups.calibration import calibrated
from rcs.setups.lab import Lab, Stand

LAB = calibrated(
    Lab(
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
