"""FR3 with Franka Hand: a D405 at the wrist, a D435 beside the table (paper, section on setups)."""

from __future__ import annotations

from rcs.envs.task import Area
from rcs.setups.lab import CameraMount, Lab, Stand, looking

LAB = Lab(
    label="FR3",
    stands=(Stand(name="fr3", arm="fr3"),),
    end_effector="franka_hand",
    area=Area(center=(0.5, 0.0), size=(0.30, 0.40)),
    cameras={
        # In front of the hand, its body clear of the fingers, tilted to see both pads and what is below them.
        "wrist": CameraMount(
            camera="realsense_d405",
            optical=looking((0.070, 0.0, 0.045), (0.0, 0.0, 0.17), up=(1.0, 0.0, 0.0)),
            on_gripper_of="fr3",
        ),
        # Where a second robot would hold it: beside the workspace, looking across it.
        "side": CameraMount(camera="realsense_d435", optical=looking((0.66, 0.95, 0.50), (0.34, 0.0, 0.17))),
    },
)
