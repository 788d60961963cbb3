"""Contract suites: what every device and every environment must do, as tests to run on your own.

Subclass a contract in a file of your tests, say how to make your device, and run pytest:

    from rcs.testing import ArmContract

    class TestMyArm(ArmContract):
        def make_arm(self):
            return MyArm("192.168.0.1")
"""

from __future__ import annotations

import pytest

# Before the suites are imported: a failed check then shows the values that it compared.
pytest.register_assert_rewrite(
    "rcs.testing.arm_contract",
    "rcs.testing.camera_contract",
    "rcs.testing.description_contract",
    "rcs.testing.device_contract",
    "rcs.testing.env_contract",
    "rcs.testing.gripper_contract",
    "rcs.testing.hand_contract",
    "rcs.testing.safety_contract",
)

from rcs.testing.arm_contract import ArmContract  # noqa: E402  the call above comes first
from rcs.testing.camera_contract import CameraContract  # noqa: E402
from rcs.testing.description_contract import DescriptionContract  # noqa: E402
from rcs.testing.env_contract import EnvContract  # noqa: E402
from rcs.testing.gripper_contract import GripperContract  # noqa: E402
from rcs.testing.hand_contract import HandContract  # noqa: E402
from rcs.testing.safety_contract import SafetyContract  # noqa: E402

__all__ = [
    "ArmContract",
    "CameraContract",
    "DescriptionContract",
    "EnvContract",
    "GripperContract",
    "HandContract",
    "SafetyContract",
]
