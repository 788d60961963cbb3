"""Contracts of devices and environments, as tests to run on your own.

Subclass a contract in a file of your tests, return your device from one method, and run pytest:

    from rcs.testing import ArmContract

    class TestMyArm(ArmContract):
        def make_arm(self):
            return MyArm("192.168.0.1")
"""

from __future__ import annotations

import pytest
from rcs_data.lazy import load_on_use

# Before the suites are imported: a failed check then shows the values that it compared.
pytest.register_assert_rewrite(
    "rcs.testing.arm_contract",
    "rcs.testing.camera_contract",
    "rcs.testing.description_contract",
    "rcs.testing.device_contract",
    "rcs.testing.env_contract",
    "rcs.testing.gripper_contract",
    "rcs.testing.hand_contract",
    "rcs.testing.motion_contract",
    "rcs.testing.safety_contract",
    "rcs.testing.stopping_contract",
)

load_on_use(__name__)
