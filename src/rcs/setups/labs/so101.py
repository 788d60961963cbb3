"""SO101 with its own gripper: a webcam at the wrist, a D435 that sees the table diagonally."""

from __future__ import annotations

from rcs.envs.task import Area
from rcs.setups.lab import CameraMount, Lab, Stand, looking

LAB = Lab(
    label="SO101",
    stands=(Stand(name="so101", arm="so101"),),
    end_effector="so101_gripper",
    # The paper's 35 x 20 cm, with a smaller cuboid. At its far corners the gripper leans by up to 50 degrees.
    area=Area(center=(0.265, 0.0), size=(0.20, 0.35), object_scale=0.625),
    cameras={
        "diagonal": CameraMount(camera="realsense_d435", optical=looking((0.62, 0.52, 0.45), (0.16, 0.0, 0.05))),
    },
)
