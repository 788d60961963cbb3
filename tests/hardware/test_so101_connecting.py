"""Connecting to an SO101: its port, its calibration, and other arms and programs there."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.so101 import So101Driver
from rcs.hardware.so101_servos import NAMES, read_calibration
from rcs.hardware.usb import UsbDevice
from rcs.robots.so101 import SO101, SO101_GRIPPER
from rcs.virtual import VirtualProcess
from tests.hardware.virtual_so101 import PATIENT, devices, events

pytestmark = pytest.mark.hardware
pytest.importorskip("scservo_sdk", reason="the driver of SO101 arms needs feetech-servo-sdk")


@pytest.fixture
def virtual(tmp_path: Path) -> Iterator[VirtualProcess]:
    with VirtualProcess("so101", log=tmp_path / "log") as process:
        yield process


def test_arm_and_gripper_are_found_by_the_serial_number_of_their_board(virtual, monkeypatch):
    entry = virtual.site.arms["so101"]
    board = UsbDevice(path="1-2", serial="5735016631")
    monkeypatch.setattr("rcs.hardware.serial_port.usb_devices", lambda: [board])
    monkeypatch.setattr("rcs.hardware.serial_port.port_of", lambda device: entry.address.removeprefix("/dev/"))
    driver = So101Driver()
    arm = driver.arm("usb:1-2", SO101, entry.options)
    with arm, driver.gripper("usb:1-2", SO101_GRIPPER, entry.options) as gripper:
        assert gripper.state().opening == pytest.approx(1.0, abs=0.02)
    with pytest.raises(InvalidSetup, match="5735016631"), driver.arm("another", SO101, entry.options):
        pass


@pytest.mark.parametrize("how", ["options", "file"])
def test_a_calibration_of_another_arm_is_refused_by_joint_and_nothing_is_enabled(virtual, tmp_path, how):
    calibration = {name: dict(values) for name, values in virtual.site.arms["so101"].options["calibration"].items()}
    calibration["elbow_flex"]["homing_offset"] += 40
    calibration["wrist_flex"]["range_max"] -= 9
    if how == "file":
        (tmp_path / "so101.json").write_text(json.dumps(calibration))
    given = calibration if how == "options" else str(tmp_path / "so101.json")
    arm, _ = devices(virtual, calibration=given)
    with pytest.raises(DeviceFault, match=r"elbow_flex has the homing_offset.*wrist_flex has the range_max"):
        arm.open()
    assert events(tmp_path / "log", "torque") == []
    right, _ = devices(virtual)  # the bus is free again
    with right:
        assert len(right.state().joints) == 5


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda c: c.pop("gripper"), "gripper"),
        (lambda c: c["elbow_flex"].pop("range_min"), "range_min"),
        (lambda c: c["elbow_flex"].update(id=9), "the id 3"),
        (lambda c: c["elbow_flex"].update(range_max="x"), "whole numbers"),
    ],
)
def test_a_calibration_that_is_none_is_refused(change, told):
    motor = {"drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4000}
    calibration = {name: {"id": number, **motor} for number, name in enumerate(NAMES, 1)}
    assert read_calibration(calibration)["gripper"].id == 6
    change(calibration)
    with pytest.raises(InvalidSetup, match=told):
        read_calibration(calibration)


def test_without_a_file_the_servos_calibration_counts(virtual):
    arm, _ = devices(virtual, calibration=None)
    with arm:
        assert np.abs(np.array(arm.state().joints) - SO101.home).max() < 0.01


def test_the_range_that_a_joint_was_calibrated_for_is_a_limit():
    motor = {"drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4000}
    calibration = {name: {"id": number, **motor} for number, name in enumerate(NAMES, 1)}
    calibration["shoulder_lift"].update(range_min=1100, range_max=3000)
    limits = So101Driver().arm("/dev/none", SO101, {"calibration": calibration}).limits
    half = 950 / 4096 * 2 * np.pi
    assert half < SO101.joint_upper[1]
    assert limits.joint_upper == pytest.approx([SO101.joint_upper[0], half, *SO101.joint_upper[2:]])
    assert limits.joint_lower == pytest.approx([SO101.joint_lower[0], -half, *SO101.joint_lower[2:]])


def test_servos_that_were_calibrated_for_less_than_the_limits_are_not_enabled(virtual, tmp_path):
    entry = virtual.site.arms["so101"]
    about = replace(SO101, joint_upper=(*SO101.joint_upper[:2], SO101.joint_upper[2] + 0.2, *SO101.joint_upper[3:]))
    with So101Driver().arm(entry.address, about, {"timeout": PATIENT}) as arm:
        arm.command_joints(arm.state().joints)
        limit = time.monotonic() + 5.0
        while not arm.fault:
            assert time.monotonic() < limit
            time.sleep(0.01)
        assert "elbow_flex was calibrated for" in arm.fault and "option `calibration`" in arm.fault
    assert events(tmp_path / "log", "torque") == []


def test_a_leader_may_have_been_calibrated_for_less_than_the_limits(virtual):
    entry = virtual.site.arms["so101"]
    about = replace(SO101, joint_upper=(*SO101.joint_upper[:2], SO101.joint_upper[2] + 0.2, *SO101.joint_upper[3:]))
    with So101Driver().arm(entry.address, about, {"timeout": PATIENT}) as arm:
        arm.guide(True)
        time.sleep(0.1)
        arm.guide(False)
        time.sleep(0.1)
        assert arm.fault == ""
        arm.guide(True)


def test_a_gripper_that_lost_its_supply_is_switched_on_by_the_first_command_after_recover(virtual, tmp_path):
    entry = virtual.site.arms["so101"]
    driver = So101Driver()
    with driver.gripper(entry.address, SO101_GRIPPER, {"timeout": PATIENT}) as gripper:
        gripper.command_opening(0.9)
        virtual.tell("cut")
        limit = time.monotonic() + 5.0
        while not gripper.fault:
            with contextlib.suppress(DeviceFault):
                gripper.state()
            assert time.monotonic() < limit
        virtual.tell("clear")
        with gripper.link as servos:
            servos.reconnect()
            servos.release([6])  # as at the loss of its supply
        gripper.recover()
        gripper.command_opening(0.9)
    assert [event["on"] for event in events(tmp_path / "log", "torque")] == [True, False, True, False]


def test_every_device_checks_the_calibration_that_it_was_given_and_the_longest_timeout_counts(virtual, tmp_path):
    entry = virtual.site.arms["so101"]
    driver, right = So101Driver(), entry.options["calibration"]
    wrong = {**right, "elbow_flex": {**right["elbow_flex"], "range_max": right["elbow_flex"]["range_max"] - 7}}
    with (
        driver.arm(entry.address, SO101, {"calibration": right, "timeout": PATIENT}) as arm,
        driver.gripper(entry.address, SO101_GRIPPER, {}),
        arm.link as servos,
    ):
        assert servos.bus.timeout == PATIENT  # the longest
    with driver.gripper(
        entry.address, SO101_GRIPPER, {"timeout": PATIENT}
    ):  # the driver of a host that stays, and without a file first
        with pytest.raises(DeviceFault, match="elbow_flex has the range_max"):
            driver.arm(entry.address, SO101, {"calibration": wrong, "timeout": PATIENT}).open()
        with driver.arm(entry.address, SO101, {"calibration": right, "timeout": PATIENT}):
            pass


def test_a_servo_of_another_model_is_refused(virtual):
    virtual.tell("version", "1284")
    arm, _ = devices(virtual)
    with pytest.raises(DeviceFault, match=r"shoulder_pan has the model number 1284.*777"):
        arm.open()


def test_a_port_that_is_mute_or_not_there_is_told_within_three_seconds(virtual, tmp_path):
    virtual.tell("cut")
    arm, _ = devices(virtual)
    begin = time.monotonic()
    with pytest.raises(DeviceFault, match="check the power supply"):
        arm.open()
    assert time.monotonic() - begin < 3.0
    nowhere = So101Driver().arm(str(tmp_path / "ttyACM9"), SO101, {})
    with pytest.raises(DeviceFault, match="ttyACM9"):
        nowhere.open()


def test_a_second_program_at_one_port_is_refused_and_told_who_has_it(virtual):
    arm, _ = devices(virtual)
    with arm:
        code = (
            "import sys; from rcs.hardware.so101 import *; from rcs.robots.so101 import SO101\n"
            "try: So101Driver().arm(sys.argv[1], SO101, {}).open()\nexcept DeviceFault as err: print(err)"
        )
        told = subprocess.run([sys.executable, "-c", code, arm.name], capture_output=True, text=True)
        assert f"process {os.getpid()}" in told.stdout, told.stderr
        assert arm.fault == ""
