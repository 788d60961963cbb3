"""The driver of SO101 arms, with the vendor's library over a real serial line, against the virtual arm."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rcs
from rcs.errors import DeviceFault, InvalidAction, InvalidSetup
from rcs.hardware.servo_bus import ServoBus
from rcs.hardware.so101 import FRESH, So101Arm, So101Driver, So101Gripper
from rcs.hardware.so101_servos import GRIPPER, NAMES
from rcs.robots.so101 import SO101
from rcs.virtual import VirtualProcess, read_points, read_ticks
from tests.hardware.virtual_so101 import PATIENT, devices, events

pytestmark = pytest.mark.hardware
pytest.importorskip("scservo_sdk", reason="the driver of SO101 arms needs feetech-servo-sdk")

TO = np.array([0.25, 0.3, -0.3, -0.3, 0.2])


@pytest.fixture
def virtual(tmp_path: Path) -> Iterator[VirtualProcess]:
    with VirtualProcess("so101", log=tmp_path / "log") as process:
        yield process


def switch_on(arm: So101Arm) -> None:
    """Command the arm to stay, and wait until its motors do."""
    arm.command_joints(arm.state().joints)
    wait_until(lambda: arm.state().mode == "position")


def lead(arm: So101Arm, to: np.ndarray, seconds: float = 1.0) -> None:
    start = np.array(arm.state().joints)
    for part in np.linspace(0, 1, round(seconds * 30)):
        arm.command_joints(start + (to - start) * part)
        time.sleep(1 / 30)


def bus_of(device: So101Arm | So101Gripper) -> ServoBus:
    with device.link as servos:
        return servos.bus


def settings_of(gripper: So101Gripper) -> bytes:
    """Return the first 50 registers of the gripper's servo; no other thread is on the bus meanwhile."""
    with gripper.link as servos:
        return servos.bus.read([GRIPPER], 0, 50)[GRIPPER][1]


def position_of_lift(arm: So101Arm) -> int:
    with arm.link as servos:
        return servos.read().positions[2]


def wait_until(is_so, patience: float = 8.0) -> None:
    end = time.monotonic() + patience
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_opening_switches_nothing_on_and_the_first_command_holds_where_the_arm_is(virtual, tmp_path):
    arm, gripper = devices(virtual)
    with arm, gripper:
        assert arm.state().mode == "off"
        assert gripper.state().opening == pytest.approx(1.0, abs=0.02)
        assert events(tmp_path / "log", "torque") == []
        switch_on(arm)
        assert [event["servo"] for event in events(tmp_path / "log", "torque")] == list(NAMES[:5])


def test_arm_and_gripper_go_where_they_are_told(virtual):
    arm, gripper = devices(virtual)
    with arm, gripper:
        target = np.array(arm.state().joints) + TO
        lead(arm, target)
        wait_until(lambda: np.abs(arm.state().joints - target).max() < 0.02)
        gripper.command_opening(0.4, 9.0)
        wait_until(lambda: abs(gripper.state().opening - 0.4) < 0.03)
        wait_until(gripper.has_arrived)
        wait_until(arm.has_arrived)


def test_a_hold_stops_the_arm_and_the_next_command_goes_on(virtual):
    arm, _ = devices(virtual)
    with arm:
        start = np.array(arm.state().joints)
        switch_on(arm)
        arm.command_joints(start + [1.5, 0, 0, 0, 0])
        wait_until(lambda: arm.state().joints[0] > start[0] + 0.05)
        arm.hold()
        time.sleep(0.4)
        held = np.array(arm.state().joints)
        assert held[0] < start[0] + 1.4
        time.sleep(0.3)
        assert np.abs(arm.state().joints - held).max() < 0.01
        lead(arm, start, 1.0)
        wait_until(lambda: np.abs(arm.state().joints - start).max() < 0.02)


def test_a_first_target_that_is_far_away_is_refused_and_switches_nothing_on(virtual, tmp_path):
    arm, _ = devices(virtual)
    with arm, pytest.raises(InvalidAction, match="rad"):
        arm.command_joints(np.array(arm.state().joints) + [0, 0.9, 0, 0, 0])
    assert events(tmp_path / "log", "torque") == []


def test_the_grippers_torque_and_current_are_capped(virtual):
    arm, gripper = devices(virtual)
    with arm, gripper:
        gripper.command_opening(0.9)
        settings = settings_of(gripper)
        assert int.from_bytes(settings[16:18], "little") == 500
        assert int.from_bytes(settings[28:30], "little") == 250
        gripper.command_opening(0.5, 9.0)
        settings = settings_of(gripper)
        assert int.from_bytes(settings[48:50], "little") == 250


@pytest.mark.parametrize("fault", [("late", "300/100"), ("lose", "1/100"), ("corrupt", "1/100"), ("all",)])
def test_no_joint_is_read_wrong_where_one_packet_in_100_goes_wrong(virtual, tmp_path, fault):
    arm, _ = devices(virtual)
    readings: list[tuple[float, np.ndarray]] = []
    with arm:
        start = np.array(arm.state().joints)
        switch_on(arm)
        every = (("late", "300/300"), ("lose", "1/300"), ("corrupt", "1/300"))
        for one in every if fault == ("all",) else (fault,):
            virtual.tell(*one)
        begin = time.monotonic()
        while (passed := time.monotonic() - begin) < 3.0:
            arm.command_joints(start + TO * (1 - np.cos(2 * passed)) / 2)
            state = arm.state()
            readings.append((state.time, np.array(state.joints)))
            time.sleep(5e-3)
        assert arm.fault == ""
        assert bus_of(arm).failures > 0
    virtual.close()
    ticks = read_ticks(tmp_path / "log")
    for at, joints in readings:
        near = ticks["joints"][np.abs(ticks["time"] - at) < 0.15]
        assert ((near.min(axis=0) - 4e-3 <= joints) & (joints <= near.max(axis=0) + 4e-3)).all()


def test_an_overload_is_named_by_joint_and_recovers_without_a_lunge(virtual, tmp_path):
    arm, _ = devices(virtual)
    with arm:
        start = np.array(arm.state().joints)
        lead(arm, start + TO)
        virtual.tell("overload", "shoulder_lift")
        wait_until(lambda: arm.fault != "")
        assert "overload at shoulder_lift" in arm.fault
        with pytest.raises(DeviceFault):
            arm.command_joints(start)
        time.sleep(0.5)
        before = position_of_lift(arm)
        arm.recover()
        began = time.monotonic()
        time.sleep(0.4)
        assert abs(position_of_lift(arm) - before) < 40
        here = np.array(arm.state().joints)
        lead(arm, here + 0.3 * (start - here), 0.5)
        assert arm.fault == ""
    virtual.close()
    ticks = read_ticks(tmp_path / "log")
    after = ticks[(ticks["time"] > began) & (ticks["time"] < began + 0.4)]
    assert np.abs(after["velocities"]).max() < 0.5


def test_goals_come_to_rest_at_the_end_of_the_range_instead_of_being_cut_off(virtual, tmp_path):
    arm, _ = devices(virtual)
    with arm:
        end = np.array(arm.state().joints)
        end[3] = arm.limits.joint_upper[3]
        switch_on(arm)
        arm.command_joints(end)
        time.sleep(1.0)
        assert arm.fault == ""
    virtual.close()
    goals = read_points(tmp_path / "log")["joints"][:-1, 3]  # the last one is where it stays when it is closed
    assert goals.max() > end[3] - 0.02
    quantum, rate = 2 * np.pi / 4096, 100.0
    accelerations = (np.abs(np.diff(goals, 2)) - 2 * quantum) * rate**2
    assert accelerations.max() < 1.01 * arm.limits.joint_acceleration[3]


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        (("undervoltage",), r"undervoltage at shoulder_pan.*3.6 V.*power supply"),
        (("code", "4"), r"overheating at shoulder_pan"),
        (("cut",), r"none of the servos answers.*cable"),
        (("lose", "400"), r"none of the servos answers"),
        (("freeze", "2"), r"none of the servos answers"),
    ],
)
def test_what_goes_wrong_is_told_in_words_and_mended_by_recover(virtual, fault, told):
    arm, gripper = devices(virtual, timeout=0.2)
    with arm, gripper:
        switch_on(arm)
        virtual.tell(*fault)
        begin = time.monotonic()
        wait_until(lambda: arm.fault != "", 5.0)
        assert re.search(told, arm.fault)
        assert time.monotonic() - begin < 4.0
        with pytest.raises(DeviceFault):
            arm.recover()
        virtual.tell("clear")
        wait_until(lambda: recovers(arm))
        switch_on(arm)
        assert arm.fault == ""


def test_devices_of_a_mute_bus_do_not_wait_one_after_the_other(virtual):
    _, gripper = devices(virtual, timeout=0.09)
    with gripper, gripper.link as servos:
        virtual.tell("freeze", "2")
        asked = []
        for before in (lambda: None, lambda: None, servos.reconnect):
            before()
            failures = servos.bus.failures
            with pytest.raises(DeviceFault, match="none of the servos answers"):
                servos.read()
            asked.append(servos.bus.failures - failures)
        assert asked[0] > 1, "the first is repeated"
        assert asked[1:] == [0, 1], "the next is known to fail; recover asks once"
        virtual.tell("clear")
        wait_until(lambda: recovers(gripper))


def recovers(device: So101Arm | So101Gripper) -> bool:
    try:
        device.recover()
    except DeviceFault:
        return False
    return True


def test_a_cable_that_was_out_is_found_again_by_recover(tmp_path):
    port = str(tmp_path / "ttyACM0")
    with VirtualProcess("so101", address=port) as first:
        arm, gripper = devices(first)
        arm.open()
        gripper.open()
        switch_on(arm)
    wait_until(lambda: arm.fault != "")
    assert "has disappeared" in arm.fault
    time.sleep(FRESH)  # until then, the gripper takes the arm's last reading
    with pytest.raises(DeviceFault, match="has disappeared"):
        gripper.state()
    assert not recovers(arm)
    with VirtualProcess("so101", address=port), arm, gripper:
        arm.recover()
        gripper.recover()
        switch_on(arm)
        assert arm.fault == gripper.fault == ""


def test_a_guided_arm_is_a_leader_whose_joints_are_read(virtual, tmp_path):
    arm, gripper = devices(virtual)
    with arm, gripper:
        switch_on(arm)
        arm.guide(True)
        wait_until(lambda: arm.state().mode == "off")
        off = [event["servo"] for event in events(tmp_path / "log", "torque") if not event["on"]]
        assert off == list(NAMES[:5])
        before = arm.state().joints
        wait_until(lambda: np.abs(np.array(arm.state().joints) - before).max() > 0.02)  # it falls
        assert 0.0 <= gripper.state().opening <= 1.0


def test_at_close_the_arm_holds_or_is_released(virtual, tmp_path):
    for at_close in ("hold", "release"):
        arm, _ = devices(virtual, at_close=at_close)
        with arm:
            switch_on(arm)
        off = [event for event in events(tmp_path / "log", "torque") if not event["on"]]
        assert bool(off) == (at_close == "release")


def test_options_that_are_none_are_refused():
    driver = So101Driver()
    for options in ({"at_close": "drop"}, {"timeout": 0}, {"calibratoin": 1}):
        with pytest.raises(InvalidSetup, match=r"valid|calibration"):
            driver.arm("/dev/null", SO101, options)
    with pytest.raises(InvalidSetup, match="serial port"):
        driver.arm("", SO101, {})


def test_an_environment_moves_the_virtual_arm(virtual):
    entries = {kind: {"so101": replace(entry["so101"], options={**entry["so101"].options, "timeout": PATIENT})}
               for kind, entry in (("arms", virtual.site.arms), ("grippers", virtual.site.grippers))}  # fmt: skip
    site = replace(virtual.site, **entries)
    with rcs.make("Free", robot="so101", hardware=site, relative=True, frequency=20) as env:
        observation, _ = env.reset()
        start = observation["joints"].copy()
        for _ in range(20):
            observation, _, _, truncated, info = env.step({"joints": 0.01 * np.sign(TO), "gripper": np.zeros(1)})
            assert not truncated, info
        assert np.abs(observation["joints"] - start).min() > 0.1
        assert observation["gripper"][0] < 0.7
