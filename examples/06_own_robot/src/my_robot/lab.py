"""The lab of our arm, with a Franka Hand, a camera next to the table and one at the wrist."""

from __future__ import annotations

from typing import Final

from rcs.envs import Area
from rcs.setups import CameraMount, Lab, Stand, looking

LAB: Final = Lab(
    stands=(Stand(name="my_robot", arm="my_robot"),),
    end_effector="franka_hand",
    # The hand can point down at every place here, at any yaw, from the table to 0.3 m above it.
    area=Area(center=(0.45, 0.0), size=(0.30, 0.40)),
    cameras={
        "wrist": CameraMount(
            camera="realsense_d405",
            optical=looking((0.070, 0.0, 0.045), (0.0, 0.0, 0.17), up=(1.0, 0.0, 0.0)),
            on_gripper_of="my_robot",
        ),
        "side": CameraMount(camera="realsense_d435", optical=looking((0.66, 0.95, 0.50), (0.34, 0.0, 0.17))),
    },
)
"""The lab of our arm."""
