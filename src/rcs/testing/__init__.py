"""Contracts of devices and environments, as tests to run on your own.

Subclass a contract in a file of your tests, return your device from one method, and run pytest:

    from rcs.testing import ArmContract

    class TestMyArm(ArmContract):
        def make_device(self):
            return MyArm("192.168.0.1")
"""

from __future__ import annotations

import pytest
from rcs_data.lazy import load_on_use

# Before the suites are imported: a failed check then shows the values that it compared.
_KINDS = ("arm", "camera", "description", "device", "env", "gripper", "hand", "motion", "stopping", "tactile")
pytest.register_assert_rewrite(*(f"{__name__}.{kind}_contract" for kind in _KINDS))

load_on_use(__name__)
