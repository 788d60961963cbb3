"""Drivers in a process of their own: whatever happens to one side, the devices hold, and the other side says why."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Generator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from unruly import drop, holds, keep_interpreter

from rcs.devices import Arm, Gripper, Hand
from rcs.errors import DeviceFault, InvalidAction, MissingDependency
from rcs.hardware import hosted
from rcs.hardware.hosted import Place
from rcs.robots.fr3 import FR3
from rcs.robots.tilburg_hand import TILBURG_HAND
from rcs.testing import ArmContract, GripperContract, HandContract
from tests.hardware.hosting import (
    FAR,
    HOME,
    is_running,
    made,
    unruly_arm,
    unruly_gripper,
    wait_for,
)


def fails(call: Callable[[], object]) -> bool:
    try:
        call()
    except DeviceFault:
        return True
    return False


class Staying:
    """A host that stays, so that each test of a contract does not start one."""

    driver: str

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def _host(cls) -> Generator[None]:
        with hosted.start_all([Place(driver=cls.driver, address=cls.__name__)]):
            yield

    @property
    def address(self) -> str:
        return type(self).__name__


class UnrulyOnes(Staying):
    driver = "unruly:UnrulyDriver"

    @pytest.fixture(autouse=True)
    def _box(self, tmp_path: Path) -> None:
        self.box = tmp_path

    def lose_link(self, device: Any) -> None:
        (self.box / "cut").touch()
        wait_for(lambda: fails(device.state))

    def restore_link(self, device: Any) -> None:
        (self.box / "cut").unlink()

    def provoke_fault(self, device: Any) -> None:
        drop(self.box, "state", "trip")
        wait_for(lambda: device.fault)


class TestHostedArm(UnrulyOnes, ArmContract):
    stopping_time = 0.05
    distance = 0.8

    def make_device(self) -> Arm:
        return unruly_arm(self.box, self.address)


class TestHostedGripper(UnrulyOnes, GripperContract):
    stopping_time = 0.05

    def make_device(self) -> Gripper:
        return unruly_gripper(self.box, self.address)


class TestHostedHand(Staying, HandContract):
    driver = "fake"
    stopping_time = 0.05

    def make_device(self) -> Hand:
        return made("hand", self.driver, self.address, TILBURG_HAND)


class TestHostedStandIn(Staying, ArmContract):
    driver = "sim"
    tolerance = 5e-3

    def make_device(self) -> Arm:
        return made("arm", self.driver, self.address, FR3)


# --- What goes wrong in the host --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("deed", "text"),
    [("abort", r"ended with signal 6"), ("crash", r"ended with signal 11"), ("exit", r"ended with exit code 7")],
)
def test_a_host_that_crashes_is_a_fault_of_its_devices_and_recover_starts_another(
    deed: str, text: str, tmp_path: Path
) -> None:
    with unruly_arm(tmp_path) as arm, unruly_gripper(tmp_path) as gripper:
        assert arm.host == gripper.host
        arm.command_joints(FAR)
        drop(tmp_path, "state", deed)
        wait_for(lambda: arm.fault and gripper.fault)
        for device in (arm, gripper):
            assert device.fault.startswith(f"the host of {device.name} (process ")
            assert text in device.fault
            with pytest.raises(DeviceFault, match=text):
                device.state()
        with pytest.raises(DeviceFault, match="recover"):
            arm.command_joints(FAR)
        arm.recover()
        gripper.recover()
        assert arm.host == gripper.host != 0
        np.testing.assert_allclose(arm.state().joints, HOME)
        arm.command_joints(FAR)


def test_a_device_whose_host_cannot_be_started_again_stays_lost_until_it_can(tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        drop(tmp_path, "state", "abort")
        wait_for(lambda: arm.fault)
        for _ in range(2):
            drop(tmp_path, "open", "raise")
            with pytest.raises(DeviceFault, match="IndexError: list index"):
                arm.recover()
            for call in (arm.state, arm.hold, lambda: arm.command_joints(FAR)):
                with pytest.raises(DeviceFault, match="ended with signal 6"):
                    call()
        arm.recover()
        arm.state()


def test_recover_clears_a_fault_that_a_new_host_finds(tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        drop(tmp_path, "state", "abort")
        wait_for(lambda: arm.fault)
        drop(tmp_path, "state", "trip")
        arm.recover()
        time.sleep(0.05)
        assert arm.fault == ""


def test_waiting_for_a_recover_that_finds_another_fault_takes_no_time_of_the_processor(tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        drop(tmp_path, "recover", "trip and pause")
        begin, used = time.monotonic(), time.process_time()
        with pytest.raises(DeviceFault, match="collision"):
            arm.recover()
        used = time.process_time() - used
        assert used < 0.05 < 0.15 <= time.monotonic() - begin


@pytest.mark.parametrize("call", ["state", "command", "hold"])
@pytest.mark.parametrize("deed", ["hang", "keep"])
def test_a_call_that_does_not_return_is_a_fault_and_its_host_is_killed(deed: str, call: str, tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        host = arm.host
        drop(tmp_path, call, deed)
        with pytest.raises(DeviceFault, match="hangs: it did not return from"):  # noqa: PT012  whichever meets it
            if call == "hold":
                arm.hold()
            for _ in range(500):
                arm.command_joints(HOME)
                time.sleep(0.01)
        assert "and was killed" in arm.fault
        wait_for(lambda: not is_running(host))
        arm.recover()
        assert arm.host != host
        arm.state()


@pytest.mark.parametrize("call", ["state", "command", "hold"])
def test_what_a_driver_raises_is_its_devices_fault_in_its_words(call: str, tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        host = arm.host
        drop(tmp_path, call, "raise")
        with pytest.raises(DeviceFault, match="IndexError: list index out of range"):  # noqa: PT012
            for _ in range(1000):
                arm.command_joints(HOME)
                arm.hold()
                arm.state()
        if call != "hold":
            wait_for(lambda: "IndexError: list index out of range" in arm.fault)
        arm.recover()
        assert (arm.fault, arm.host) == ("", host)


def test_a_failure_to_close_is_raised_as_without_a_host(tmp_path: Path) -> None:
    arm = unruly_arm(tmp_path)
    arm.open()
    drop(tmp_path, "close", "raise")
    with pytest.raises(DeviceFault, match="IndexError: list index out of range"):
        arm.close()
    arm.close()  # a second time is harmless


def test_opening_and_closing_is_never_a_fault(tmp_path: Path) -> None:
    arm = unruly_arm(tmp_path)
    for _ in range(20):
        with arm:
            arm.state()
        assert arm.fault == ""


def test_a_command_that_a_driver_refuses_raises_its_words(tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        drop(tmp_path, "command", "refuse")
        with pytest.raises((InvalidAction, DeviceFault), match="2 rad away"):  # noqa: PT012  late: a fault
            for _ in range(1000):
                arm.command_joints(FAR)
                arm.state()


def test_a_command_that_takes_its_time_keeps_nobody_waiting_and_is_not_carried_out_after_a_hold(tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        drop(tmp_path, "command", "pause")
        arm.command_joints(HOME)
        begin = time.monotonic()
        arm.command_joints(FAR)
        taken = time.monotonic() - begin
        arm.hold()
        assert arm.has_arrived()  # after the pause
        assert taken < 0.14
        np.testing.assert_allclose(arm.state().joints, HOME, atol=1e-9)


def test_a_command_that_is_refused_late_is_a_fault_whatever_is_asked_next(tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        for _ in range(3):
            drop(tmp_path, "command", "refuse late")
            arm.command_joints(FAR)
            with suppress(DeviceFault):
                arm.has_arrived()
            wait_for(lambda: "refused late: the first target is 2 rad away" in arm.fault)
            arm.recover()


def test_a_command_that_is_refused_late_holds_an_arm_on_its_way(tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        arm.command_joints(FAR)
        wait_for(lambda: np.abs(arm.state().joints - HOME).max() > 0.01)
        drop(tmp_path, "command", "refuse late")
        arm.command_joints(FAR)
        wait_for(lambda: arm.fault)
        wait_for(lambda: holds(tmp_path))
        time.sleep(0.1)
        stands = np.array(arm.state().joints)
        assert np.abs(stands - FAR).max() > 0.01
        time.sleep(0.1)
        np.testing.assert_allclose(arm.state().joints, stands, atol=1e-9)


def test_commands_that_are_refused_late_are_a_fault_while_others_follow(tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        with pytest.raises((DeviceFault, InvalidAction), match="2 rad away"):  # noqa: PT012
            for _ in range(50):
                drop(tmp_path, "command", "refuse late")
                arm.command_joints(HOME)
                time.sleep(0.02)
        wait_for(lambda: "refused late" in arm.fault)
        (tmp_path / "command").unlink(missing_ok=True)
        arm.recover()
        assert arm.fault == ""


def test_a_controller_may_take_its_time_to_give_way(tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        host = arm.host
        drop(tmp_path, "guide", "settle")
        arm.guide(True)
        assert (arm.is_guided, arm.fault, arm.host) == (True, "", host)


def test_a_library_that_keeps_the_interpreter_while_it_recovers_and_closes_is_no_fault_of_other_devices(
    tmp_path: Path,
) -> None:
    with unruly_gripper(tmp_path) as gripper, unruly_arm(tmp_path) as arm:
        for call in ("recover", "close"):
            drop(tmp_path, call, "keep half a second")
            getattr(arm, call)()
        gripper.state()
        assert gripper.fault == ""


def test_opening_raises_what_the_driver_raises(tmp_path: Path) -> None:
    arm = unruly_arm(tmp_path)
    drop(tmp_path, "open", "lack")
    with pytest.raises(MissingDependency, match="robot-control-stack"):
        arm.open()
    drop(tmp_path, "open", "raise")
    with pytest.raises(DeviceFault, match="IndexError: list index"):
        arm.open()
    drop(tmp_path, "open", "abort")
    with pytest.raises(DeviceFault, match="ended while opening"):
        arm.open()
    assert not arm.is_open
    with arm:
        arm.state()


@pytest.mark.parametrize("deed", ["hang", "keep"])
def test_opening_that_does_not_return_ends_with_the_address_and_what_to_look_at(deed: str, tmp_path: Path) -> None:
    arm = unruly_arm(tmp_path, "192.0.2.7")
    drop(tmp_path, "open", deed)
    with pytest.raises(DeviceFault, match=r"192\.0\.2\.7 did not end within 1\.5 s.*Check the address, the cable"):
        arm.open()
    with arm:
        arm.state()


def test_a_host_whose_process_is_unknown_is_not_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In another container's namespace its number is 0, and to kill 0 is to kill this process and its whole group."""
    killed: list[int] = []
    hosts: list[int] = []
    kill, peer = os.kill, hosted.peer
    monkeypatch.setattr("os.kill", lambda process, _: killed.append(process))
    monkeypatch.setattr(hosted, "peer", lambda connection: hosts.append(peer(connection)) or 0)
    arm = unruly_arm(tmp_path, "192.0.2.8")
    drop(tmp_path, "open", "hang")
    try:
        with pytest.raises(DeviceFault, match="did not end within"):
            arm.open()
    finally:
        for host in filter(None, hosts):
            kill(host, signal.SIGKILL)
    assert killed == []


# --- What goes wrong in the program -----------------------------------------------------------------------------------


def test_a_device_holds_in_time_while_the_program_keeps_the_interpreter(tmp_path: Path) -> None:
    """Not tight, as tests share their machine; `benchmarks/hardware.py --only hosted` has the figures."""
    with unruly_arm(tmp_path) as arm:
        before, begin = len(holds(tmp_path)), time.monotonic()
        arm.command_joints(FAR, 0.05)
        keep_interpreter(0.8)
        kept = time.monotonic() - begin
        first = holds(tmp_path)[before] - begin
        assert 0.05 <= first < kept - 0.2
        arm.command_joints(HOME)
        assert arm.fault == ""
