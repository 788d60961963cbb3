"""A virtual FR3 for the tests of its drivers: how it is started, an arm that is open there, and what goes wrong."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator

from rcs.hardware.franka import FrankaArm, FrankaOptions
from rcs.robots import FR3
from rcs.virtual import VirtualProcess

ADDRESS = f"127.{64 + (os.getpid() >> 8) % 64}.{os.getpid() % 250 + 1}.52"
"""Where the tests with `franky-control` start it."""
STIFF = FrankaOptions(collision_force=400.0, collision_torque=(80.0,) * 7)
"""Limits with which it does not matter what the virtual robot touches."""
TROUBLES = [
    (("reflex",), r"Reflex.*joint_reflex.*joint4.*something pushed"),
    (("user_stop",), r"user stop.*release"),
    (("brakes",), r"locked.*Desk"),
    (("code", 26), r"power_limit_violation.*too much power"),
    (("lose", 40), r"communication_constraints_violation.*were late"),
    (("freeze", 1.5), r"not answered|no state"),
    (("cut",), r"not answered|no state|link"),
]
"""Faults that it is told, and what its drivers say of them."""


@contextlib.contextmanager
def virtual_fr3(address: str = ADDRESS) -> Iterator[VirtualProcess]:
    with VirtualProcess("fr3", address=address) as process:
        with contextlib.suppress(PermissionError):  # a controller is never late
            os.sched_setscheduler(process.pid, os.SCHED_FIFO, os.sched_param(40))
        yield process


def an_arm(options: FrankaOptions = STIFF, *, is_well: bool = True) -> FrankaArm:
    """An open arm; one that an earlier test left in a reflex is recovered."""
    arm = FrankaArm(ADDRESS, FR3, options)
    arm.open()
    if is_well:
        time.sleep(0.05)
        arm.recover()
        time.sleep(0.05)
    return arm
