"""An xArm7 by the vendor's library, against a virtual one behind the same protocol."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Generator, Iterator
from typing import Any

import numpy as np
import pytest
from moving import is_measured, lead, wait_for_fault, wait_until
from numpy.typing import NDArray

import rcs
from rcs import Setup
from rcs.devices import Arm, CommandKind, Gripper, GripperState
from rcs.errors import DeviceFault, InvalidAction, InvalidSetup
from rcs.hardware.xarm import XarmDriver
from rcs.kinematics import kinematics_of
from rcs.robots import ROBOTIQ_2F85, XARM7
from rcs.spatial import Pose
from rcs.testing import ArmContract
from rcs.virtual import VirtualProcess

pytestmark = [
    pytest.mark.hardware,
    pytest.mark.filterwarnings("ignore:The 'warn' method:DeprecationWarning"),  # the library's
]
pytest.importorskip("xarm", reason="the extra `xarm` is not installed")

ADDRESS = f"127.{64 + (os.getpid() >> 8) % 64}.{os.getpid() % 250 + 1}.21"
# Slow enough for a busy machine without real-time priority: late ticks are not what is tested here.
CALM = {"rate": 100}
HOME = np.array(XARM7.home)


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Generator[VirtualProcess]:
    setup = tmp_path_factory.mktemp("xarm") / "setup.json"
    setup.write_text(json.dumps(Setup(task="Free", robot="xarm7", end_effector="robotiq_2f85").to_json()))
    try:
        with VirtualProcess("xarm7", address=ADDRESS, setup=setup) as virtual:
            yield virtual
    except InvalidSetup as err:
        if "ip_unprivileged_port_start" not in str(err):
            raise
        pytest.skip(str(err))


@pytest.fixture
def virtual(served: VirtualProcess) -> VirtualProcess:
    """Return the virtual robot, mended."""
    served.tell("clear")
    return served


@pytest.fixture
def arm(virtual: VirtualProcess) -> Iterator[Arm]:
    """Give an open arm, which is closed in the end."""
    with XarmDriver().arm(ADDRESS, XARM7, CALM) as arm:
        arm.recover()
        time.sleep(0.05)  # the hold that comes with it is taken in the next tick
        yield arm


@pytest.mark.slow
class TestContract(ArmContract):
    """The contract of all arms."""

    virtual: VirtualProcess
    stopping_time = 0.5
    tolerance = 8e-3  # what its servos sag under the gripper, stretched out
    speed_margin = 1.5  # points come early and late on a busy machine, and the joints follow them

    @pytest.fixture(autouse=True)
    def _mended(self, virtual: VirtualProcess) -> None:
        type(self).virtual = virtual

    def make_device(self) -> Arm:
        return XarmDriver().arm(ADDRESS, XARM7, CALM)

    def provoke_fault(self, device: Arm) -> None:
        self.virtual.tell("reflex")
        wait_for_fault(device)

    def lose_link(self, device: Arm) -> None:
        self.virtual.tell("cut")
        wait_for_fault(device)
        wait_until(lambda: not is_measured(device))

    def restore_link(self, device: Arm) -> None:
        self.virtual.tell("clear")
        time.sleep(0.1)


def place() -> NDArray[np.float64]:
    """Return where the virtual robot is, over another connection."""
    with XarmDriver().arm(ADDRESS, XARM7, CALM) as other:
        return other.state().joints


def test_joints_and_times_are_those_of_the_robot(arm: Arm) -> None:
    target = HOME + np.array([0.1, -0.05, 0.08, 0.02, -0.1, 0.15, 0.1])
    lead(arm, target)
    state = arm.state()
    assert state.joints == pytest.approx(target, abs=4e-3)
    assert state.commanded_joints == pytest.approx(target, abs=1e-3)
    assert state.mode == "servo"
    assert np.abs(state.efforts).max() > 1.0  # against gravity
    assert 0.0 <= time.monotonic() - state.time < 0.3
    assert place() == pytest.approx(state.joints, abs=1e-3)
    lead(arm, HOME)


def test_opening_switches_nothing_on_and_the_first_command_does(virtual: VirtualProcess) -> None:
    virtual.tell("user_stop")  # takes the power
    virtual.tell("clear")
    with XarmDriver().arm(ADDRESS, XARM7, CALM) as arm:
        arm.recover()
        assert report()[88] == 0
        arm.command_joints(arm.state().joints)
        wait_until(lambda: report()[88] == 0x7F)
        assert arm.fault == ""


def report() -> bytes:
    """Return a report of the controller: the low half of byte 4 is its state, byte 88 tells which motors are on."""
    with socket.create_connection((ADDRESS, 30001), 2.0) as reports:
        return reports.recv(145, socket.MSG_WAITALL)


def test_a_first_target_far_away_is_refused_and_nothing_moves(arm: Arm) -> None:
    before = arm.state().joints
    with pytest.raises(InvalidAction, match=r"joint 1 .* 0\.5 rad away"):
        arm.command_joints(before + np.array([0, 0.5, 0, 0, 0, 0, 0]))
    assert arm.state().joints == pytest.approx(before, abs=1e-3)


@pytest.mark.parametrize(
    ("told", "reason", "limit"),
    [
        (("reflex",), "C31: collision", 0.1),
        (("overload", "joint4"), "C14: joint4", 0.1),
        (("user_stop",), "C1: emergency stop", 0.1),
        (("undervoltage",), "C10: the servos", 0.1),
        (("code", "24"), "C24: a joint was commanded too fast", 0.1),
        (("code", "99"), "C99: see the manual", 0.1),
        (("freeze", "1"), "has not answered", 0.3),
        (("lose", "400"), "has not answered", 0.3),
        (("cut",), "cable", 0.3),
    ],
)
def test_faults_are_found_in_time_and_named(
    told: tuple[str, ...], reason: str, limit: float, virtual: VirtualProcess
) -> None:
    with XarmDriver().arm(ADDRESS, XARM7, CALM) as arm:
        arm.recover()
        start = arm.state().joints
        arm.command_joints(start + 0.15)
        wait_until(lambda: abs(arm.state().joints[0] - start[0]) > 0.02)
        virtual.tell(*told)
        begin = time.monotonic()
        assert reason in wait_for_fault(arm)
        took = time.monotonic() - begin
        assert took < limit + 0.3, f"{took:.3f} s"  # the limit is for a machine that does nothing else
        with pytest.raises(DeviceFault):
            arm.command_joints(start)
        if told[0] == "freeze":
            time.sleep(1.0)
        virtual.tell("clear")
        time.sleep(0.5)
        before = place()
        arm.recover()
        assert arm.fault == ""
        assert arm.state().joints == pytest.approx(before, abs=2e-3)
        lead(arm, start)


def test_answers_that_come_late_now_and_then_stop_nothing(virtual: VirtualProcess, arm: Arm) -> None:
    virtual.tell("late", "40/50")
    start = arm.state().joints
    for way in (0.05, 0.0, 0.05, 0.0):
        lead(arm, start + way)
    assert arm.state().joints == pytest.approx(start, abs=8e-3)


def test_an_emergency_stop_stays_until_a_person_has_released_it(arm: Arm, virtual: VirtualProcess) -> None:
    virtual.tell("user_stop")
    wait_for_fault(arm)
    with pytest.raises(DeviceFault, match="release the button"):
        arm.recover()
    assert "emergency stop" in arm.fault
    virtual.tell("clear")
    arm.recover()


def test_who_changes_the_mode_meanwhile_is_told_of(arm: Arm) -> None:
    arm.command_joints(arm.state().joints)
    wait_until(lambda: arm.state().mode == "servo")
    with socket.create_connection((ADDRESS, 502)) as other:
        other.sendall(bytes([0, 1, 0, 2, 0, 3, 19, 0, 0]))  # mode 0
        assert "the mode or a setting was changed" in wait_for_fault(arm)


SECOND = """
import sys, time
from rcs.hardware.xarm import XarmDriver
from rcs.robots import XARM7
with XarmDriver().arm(sys.argv[1], XARM7, {"rate": 100}) as arm:
    arm.command_joints(arm.state().joints)
    while not arm.fault:
        time.sleep(0.01)
    print(arm.fault)
"""


def test_a_second_program_is_refused_and_the_first_goes_on(arm: Arm) -> None:
    arm.command_joints(arm.state().joints)
    wait_until(lambda: arm.state().mode == "servo")
    second = subprocess.run([sys.executable, "-c", SECOND, ADDRESS], capture_output=True, text=True, check=True)
    assert "another program already moves the arm" in second.stdout
    assert f"process {os.getpid()} (" in second.stdout
    assert "SDK_VERSION" not in second.stdout  # what the library prints is no output of ours
    with XarmDriver().arm(ADDRESS, XARM7, CALM) as other, pytest.raises(DeviceFault, match="already moves the arm"):
        other.guide(True)
    with XarmDriver().arm(ADDRESS, XARM7, CALM) as other:
        other.recover()
    time.sleep(0.2)
    assert arm.fault == ""


ORPHAN = """
import sys, time
from rcs.hardware.xarm import XarmDriver
from rcs.robots import XARM7
arm = XarmDriver().arm(sys.argv[1], XARM7, {"rate": 100})
arm.open()
start = arm.state().joints
arm.command_joints(start + 0.19)
while abs(arm.state().joints[0] - start[0]) < 0.03:
    time.sleep(0.002)
print("moves", flush=True)
time.sleep(60)
"""


def test_an_arm_whose_program_is_killed_stays_where_it_was_led_last(virtual: VirtualProcess) -> None:
    with XarmDriver().arm(ADDRESS, XARM7, CALM) as arm:
        arm.recover()
        start = arm.state().joints
    program = subprocess.Popen([sys.executable, "-c", ORPHAN, ADDRESS], stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None
    assert program.stdout.readline() == "moves\n"
    program.kill()
    program.wait()
    time.sleep(0.5)
    before = place()
    time.sleep(0.3)
    assert place() == pytest.approx(before, abs=1e-3)
    assert (before - start < 0.15).all()
    with XarmDriver().arm(ADDRESS, XARM7, CALM) as arm:
        lead(arm, start)


def test_a_tcp_that_would_be_too_fast_is_a_fault_before_the_controller_stops_it(virtual: VirtualProcess) -> None:
    stretched = np.array([0.0, 0.7, 0.0, 1.5, 0.0, 0.0, 0.0])
    with XarmDriver().arm(ADDRESS, XARM7, {**CALM, "speed": 0.8}) as arm:
        arm.recover()
        lead(arm, HOME)
        lead(arm, stretched)
        arm.command_joints(stretched + np.array([1.5, 0, 0, 0, 0, 0, 0]))
        assert "valid is at most 0.95 m/s" in wait_for_fault(arm)
        assert "C60" not in arm.fault
        arm.recover()
        lead(arm, HOME)


@pytest.mark.parametrize("told", [("lose", "3"), ("corrupt", "3"), ("lose", "1/100"), ("late", "20/100")])
def test_packets_that_are_lost_or_late_now_and_then_do_not_disturb(
    told: tuple[str, ...], virtual: VirtualProcess
) -> None:
    with XarmDriver().arm(ADDRESS, XARM7, CALM) as arm:
        arm.recover()
        start = arm.state().joints
        arm.command_joints(start)
        virtual.tell(*told)
        lead(arm, start + 0.15)
        lead(arm, start)


def test_no_packet_that_is_lost_on_the_way_into_servo_mode_is_a_fault(virtual: VirtualProcess) -> None:
    for _ in range(6):
        with XarmDriver().arm(ADDRESS, XARM7, CALM) as arm:
            arm.recover()
            virtual.tell("lose", "1/20")
            arm.command_joints(arm.state().joints)
            wait_until(lambda arm=arm: arm.fault != "" or arm.state().mode == "servo", 15.0)
            assert arm.fault == ""
            virtual.tell("clear")


TCP = (0.0, 0.0, 0.15, 0.0, 0.0, 0.0, 1.0)


def tcp_of(arm: Arm) -> Pose:
    return kinematics_of(XARM7).forward(arm.state().joints) * Pose.from_tquat(TCP)


def test_a_pose_is_reached_by_the_controller_and_joints_lead_on_from_there(virtual: VirtualProcess) -> None:
    with XarmDriver().arm(ADDRESS, XARM7, {**CALM, "tcp": TCP}) as arm:
        arm.recover()
        start = tcp_of(arm)
        goal = Pose(start.translation + [0.02, 0.03, -0.04], start.quaternion)
        arm.command_pose(goal)
        wait_until(lambda: tcp_of(arm).is_close(goal, 3e-3, 1e-2) or arm.fault != "", 5.0)
        assert arm.fault == ""
        arm.hold()
        wait_until(arm.has_arrived)
        assert tcp_of(arm).is_close(goal, 4e-3, 1e-2)
        lead(arm, HOME)


def test_without_a_tcp_poses_are_not_taken(arm: Arm) -> None:
    assert arm.commands() == {CommandKind.joints}
    with pytest.raises(InvalidAction, match="takes no pose"):
        arm.command_pose(Pose())


def test_a_guided_arm_is_read_and_then_led_from_where_it_is(arm: Arm) -> None:
    arm.guide(True)
    wait_until(lambda: arm.state().mode == "manual")
    assert arm.fault == ""
    arm.guide(False)
    lead(arm, arm.state().joints + 0.01)
    lead(arm, HOME)


def test_a_guided_arm_that_somebody_stops_stays_stopped(arm: Arm) -> None:
    arm.guide(True)
    wait_until(lambda: arm.state().mode == "manual")
    with socket.create_connection((ADDRESS, 502)) as other:
        other.sendall(bytes([0, 1, 0, 2, 0, 2, 12, 4]))  # state 4
        assert "the arm was stopped" in wait_for_fault(arm)
    time.sleep(0.3)
    assert report()[4] & 0x0F == 4


def test_the_gripper_at_the_flange_closes_on_nothing_and_opens(virtual: VirtualProcess) -> None:
    device: Any = XarmDriver().gripper(ADDRESS, ROBOTIQ_2F85, {})
    with device as gripper:
        gripper.recover()
        for opening in (0.2, 1.0):
            gripper.command_opening(opening)
            wait_until(gripper.has_arrived, 10.0)
            assert state_of(gripper).opening == pytest.approx(opening, abs=0.05)
        gripper._transport._api.disconnect()  # as after a controller's restart
        wait_until(lambda: gripper.fault != "")
        gripper.recover()
        assert state_of(gripper).opening == pytest.approx(1.0, abs=0.05)
        virtual.tell("gripper", 8)
        wait_until(lambda: gripper.fault != "")
        assert "85 °C" in gripper.fault


def state_of(gripper: Gripper) -> GripperState:
    return gripper.state()


def test_an_environment_of_a_virtual_robot_moves_arm_and_gripper(virtual: VirtualProcess) -> None:
    with XarmDriver().gripper(ADDRESS, ROBOTIQ_2F85, {}) as gripper:
        gripper.recover()
    hardware = {
        "xarm7": {"driver": "xarm", "address": ADDRESS, "options": CALM},
        "xarm7/gripper": f"xarm:{ADDRESS}",
    }
    with rcs.make(
        "Free", robot="xarm7", end_effector="robotiq_2f85", control="joints", hardware=hardware, frequency=20
    ) as env:
        first, _ = env.reset()
        step = {"joints": np.full(7, 0.004), "gripper": np.zeros(1, np.float32)}
        for _ in range(25):
            seen, _, _, truncated, info = env.step(step)
            assert not truncated, info
        assert seen["joints"] - first["joints"] == pytest.approx(0.1, abs=0.03)
        assert seen["gripper"][0] < 0.3


def test_a_firmware_that_is_too_old_is_refused(virtual: VirtualProcess) -> None:
    virtual.tell("version", "1.8.0")
    with pytest.raises(DeviceFault, match=r"firmware 1\.8\.0; the driver needs 1\.9\.0 or newer"):
        XarmDriver().arm(ADDRESS, XARM7, CALM).open()


def test_the_library_changes_no_timeout_of_other_sockets(arm: Arm) -> None:
    assert socket.getdefaulttimeout() is None
