"""A virtual SO101 for the tests of its driver: its devices, and the events of its log."""

from __future__ import annotations

from pathlib import Path

from rcs.hardware import DeviceAddress
from rcs.hardware.so101 import So101Arm, So101Driver, So101Gripper
from rcs.robots.so101 import SO101, SO101_GRIPPER
from rcs.virtual import VirtualProcess, read_events

PATIENT = 0.6
"""Time in which servos must answer where the test is of something else: the machine may be busy [s]."""


def devices(virtual: VirtualProcess, **options: object) -> tuple[So101Arm, So101Gripper]:
    entry = virtual.site.arms["so101"]
    assert isinstance(entry, DeviceAddress)
    driver, given = So101Driver(), {**entry.options, "timeout": PATIENT, **options}
    return driver.arm(entry.address, SO101, given), driver.gripper(entry.address, SO101_GRIPPER, given)


def events(log: Path, name: str) -> list[dict]:
    return [event for event in read_events(log) if event["event"] == name]
