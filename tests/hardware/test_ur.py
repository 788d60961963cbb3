"""A UR5e by the vendor's library, against a virtual one behind the same protocol."""

from __future__ import annotations

import os
import time
from collections.abc import Generator, Iterator

import numpy as np
import pytest
from moving import is_measured, lead, wait_for_fault, wait_until
from numpy.typing import NDArray

import rcs
from rcs.devices import Arm, CommandKind, StreamPoint
from rcs.errors import DeviceFault, InvalidAction, InvalidSetup
from rcs.hardware.ur import UrArm, UrDriver
from rcs.hardware.ur_controller import Dashboard
from rcs.kinematics import kinematics_of
from rcs.robots import FRANKA_HAND, ROBOTIQ_2F85, UR5E
from rcs.spatial import Pose
from rcs.testing import ArmContract
from rcs.virtual import VirtualProcess

pytestmark = pytest.mark.hardware
pytest.importorskip("rtde_control", reason="the extra `ur` is not installed")

ADDRESS = f"127.{64 + (os.getpid() >> 8) % 64}.{os.getpid() % 250 + 1}.11"
# Slow enough for a busy machine without real-time priority: late ticks and the watchdog are not what is tested here.
CALM = {"rate": 125, "watchdog": 2}


@pytest.fixture(scope="module")
def served() -> Generator[VirtualProcess]:
    with VirtualProcess("ur5e", address=ADDRESS) as virtual:
        yield virtual


@pytest.fixture
def virtual(served: VirtualProcess) -> VirtualProcess:
    """Return the virtual robot, mended."""
    served.tell("clear")
    return served


@pytest.fixture
def arm(virtual: VirtualProcess) -> Iterator[Arm]:
    """Give an open arm, which is closed in the end."""
    with UrDriver().arm(ADDRESS, UR5E, CALM) as arm:
        arm.recover()
        yield arm


@pytest.mark.slow
class TestContract(ArmContract):
    """The contract of all arms."""

    virtual: VirtualProcess
    stopping_time = 0.5
    tolerance = 4e-3

    @pytest.fixture(autouse=True)
    def _mended(self, virtual: VirtualProcess) -> None:
        type(self).virtual = virtual

    def make_device(self) -> Arm:
        return UrDriver().arm(ADDRESS, UR5E, CALM)

    def provoke_fault(self, device: Arm) -> None:
        self.virtual.tell("protective_stop")
        wait_for_fault(device)

    def lose_link(self, device: Arm) -> None:
        self.virtual.tell("cut")
        wait_for_fault(device)
        wait_until(lambda: not is_measured(device))

    def restore_link(self, device: Arm) -> None:
        self.virtual.tell("clear")
        time.sleep(0.1)


def test_joints_and_times_are_those_of_the_robot(arm: Arm) -> None:
    target = arm.state().joints + np.array([0.1, -0.05, 0.08, 0.02, -0.1, 0.15])
    lead(arm, target)
    state = arm.state()
    assert state.joints == pytest.approx(target, abs=4e-3)
    assert state.commanded_joints == pytest.approx(target, abs=1e-3)
    assert state.mode == "running"
    assert time.monotonic() - state.time < 0.3
    later = arm.state()
    assert later.device_time >= state.device_time > 0.0


def test_opening_energises_nothing_and_the_first_command_starts_the_script(virtual: VirtualProcess) -> None:
    with UrDriver().arm(ADDRESS, UR5E, CALM) as arm:
        arm.state()
        assert answer("running") == "Program running: false"
        arm.command_joints(arm.state().joints)
        wait_until(lambda: answer("running") == "Program running: true")
    assert answer("running") == "Program running: false"


def test_recover_connects_after_an_earlier_one_failed_while_it_connected(arm: Arm) -> None:
    arm.set_fault("the link is lost")
    arm._let_go()  # pyright: ignore[reportAttributeAccessIssue]
    wait_until(lambda: not is_measured(arm))
    arm.recover()
    assert is_measured(arm)
    assert arm.fault == ""


def test_a_first_target_far_away_is_refused_and_nothing_moves(arm: Arm) -> None:
    before = arm.state().joints
    with pytest.raises(InvalidAction, match=r"joint 1 .* 0\.5 rad away"):
        arm.command_joints(before + [0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    assert answer("running") == "Program running: false"
    assert arm.state().joints == pytest.approx(before, abs=1e-4)


@pytest.mark.parametrize(
    ("told", "reason", "limit"),
    [
        (("protective_stop",), "protective stop", 0.1),
        (("overload", "elbow_joint"), "elbow_joint", 0.1),
        (("user_stop",), "emergency stop", 0.1),
        (("undervoltage",), "safety fault", 0.1),
        (("power_off",), "switched off", 0.1),
        (("freeze", "1"), "nothing new", 0.3),
        (("cut",), "cable", 0.3),
    ],
)
def test_faults_are_found_in_time_and_named(
    told: tuple[str, ...], reason: str, limit: float, virtual: VirtualProcess
) -> None:
    with UrDriver().arm(ADDRESS, UR5E, CALM) as arm:
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
        virtual.tell("clear")
        if told[0] in ("freeze", "cut"):
            time.sleep(1.0)  # until it hangs no more, or has stopped by its watchdog
        else:
            time.sleep(0.5)
        before = place()
        arm.recover()
        assert arm.fault == ""
        assert arm.state().joints == pytest.approx(before, abs=2e-3)
        arm.command_joints(arm.state().joints)
        time.sleep(0.3)
        assert arm.fault == ""
        lead(arm, start)


def test_an_emergency_stop_stays_until_a_person_has_released_it(arm: Arm, virtual: VirtualProcess) -> None:
    virtual.tell("user_stop")
    wait_for_fault(arm)
    with pytest.raises(DeviceFault, match="release the button"):
        arm.recover()
    assert "emergency stop" in arm.fault
    virtual.tell("clear")
    arm.recover()


def test_an_arm_that_is_switched_off_is_read_and_not_commanded(arm: Arm, virtual: VirtualProcess) -> None:
    virtual.tell("power_off")
    wait_until(lambda: arm.state().mode == "power_off")
    assert arm.fault == ""
    arm.command_joints(arm.state().joints)
    assert "switch it on at the pendant" in wait_for_fault(arm)


def test_an_environment_of_a_virtual_robot_moves_arm_and_gripper(virtual: VirtualProcess) -> None:
    hardware = {"ur5e": {"driver": "ur", "address": ADDRESS, "options": CALM}, "ur5e/gripper": f"robotiq:{ADDRESS}"}
    with rcs.make("Free", robot="ur5e", hardware=hardware, frequency=20) as env:
        assert env.platform == {"ur5e": "ur", "ur5e/robotiq_2f85": "robotiq"}
        first, _ = env.reset()
        step = {"joints": np.full(6, 0.004), "gripper": np.zeros(1, np.float32)}
        for _ in range(25):
            seen, _, _, truncated, info = env.step(step)
            assert not truncated, info
        assert seen["joints"] - first["joints"] == pytest.approx(0.1, abs=0.03)
        assert seen["gripper"][0] < 0.3


HOME = np.array(UR5E.home)
TCP = (0.0, 0.0, 0.15, 0.0, 0.0, 0.0, 1.0)


@pytest.fixture
def tcp_arm(virtual: VirtualProcess) -> Iterator[Arm]:
    """Give an arm that takes poses, too, and bring it home in the end."""
    with UrDriver().arm(ADDRESS, UR5E, {**CALM, "tcp": TCP}) as arm:
        arm.recover()
        lead(arm, arm.state().joints)
        lead(arm, HOME)
        yield arm
        rest(arm)
        lead(arm, arm.state().joints)
        lead(arm, HOME)


def tcp_of(arm: Arm) -> Pose:
    return kinematics_of(UR5E).forward(arm.state().joints) * Pose.from_tquat(TCP)


def rest(arm: Arm) -> None:
    arm.hold()
    wait_until(arm.has_arrived)


def test_a_pose_is_reached_by_the_controller(tcp_arm: Arm) -> None:
    start = tcp_of(tcp_arm)
    goal = Pose(start.translation + [0.03, 0.04, -0.05], start.quaternion)
    tcp_arm.command_pose(goal)
    wait_until(lambda: tcp_of(tcp_arm).is_close(goal, 2e-3, 1e-2), 5.0)
    assert not tcp_arm.has_arrived()  # a pose is led until something else is said
    rest(tcp_arm)
    assert tcp_of(tcp_arm).is_close(goal, 3e-3, 1e-2)


def test_a_twist_moves_the_tcp_until_its_time_is_over(tcp_arm: Arm) -> None:
    start = tcp_of(tcp_arm)
    for _ in range(20):
        tcp_arm.command_twist(np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0]), valid_for=0.4)
        time.sleep(0.02)
    wait_until(tcp_arm.has_arrived)
    moved = tcp_of(tcp_arm).translation - start.translation
    assert 0.01 < moved[2] < 0.08
    assert moved[:2] == pytest.approx(0.0, abs=3e-3)
    assert tcp_arm.fault == ""


def test_a_twist_is_slowed_down_to_the_speed_of_the_tcp(virtual: VirtualProcess) -> None:
    with UrDriver().arm(ADDRESS, UR5E, {**CALM, "tcp": TCP, "tcp_speed": 0.02}) as arm:
        arm.recover()
        speeds: list[float] = []
        for _ in range(60):
            arm.command_twist(np.array([0.0, 0.3, 0.4, 0.0, 0.0, 0.0]), valid_for=0.4)
            time.sleep(0.02)
            state = arm.state()
            jacobian = kinematics_of(UR5E, ROBOTIQ_2F85).jacobian(state.joints)
            speeds.append(float(np.linalg.norm((jacobian @ state.joint_velocities)[:3])))
        rest(arm)
        assert np.median(speeds) == pytest.approx(0.02, rel=0.02)
        assert max(speeds) < 0.021
        lead(arm, arm.state().joints)
        lead(arm, HOME)


def test_kinds_of_commands_change_at_rest_only(tcp_arm: Arm) -> None:
    start = tcp_arm.state().joints
    tcp_arm.command_velocities(np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]))
    wait_until(lambda: tcp_arm.state().joints[0] - start[0] > 0.02)
    with pytest.raises(InvalidAction, match="another kind of command"):
        tcp_arm.command_joints(start)
    rest(tcp_arm)
    tcp_arm.command_joints(tcp_arm.state().joints)
    tcp_arm.command_pose(tcp_of(tcp_arm))
    time.sleep(0.2)
    assert tcp_arm.fault == ""


def test_without_a_tcp_poses_are_not_taken(arm: Arm) -> None:
    assert arm.commands() == {CommandKind.joints, CommandKind.velocities}
    with pytest.raises(InvalidAction, match="takes no pose"):
        arm.command_pose(Pose())


def test_what_a_driver_cannot_do_it_refuses() -> None:
    for options, match in (
        ({"rate": 1000}, "50 to 500"),
        ({"speed": 0}, "0.01 to 1"),
        ({"tcp": [0, 0, 1]}, "a sequence of 7"),
        ({"rat": 100}, "Did you mean 'rate'"),
    ):
        with pytest.raises(InvalidSetup, match=match):
            UrDriver().arm("192.0.2.1", UR5E, options)
    with pytest.raises(InvalidSetup, match="Robotiq"):
        UrDriver().gripper("192.0.2.1", FRANKA_HAND, {})
    assert UrDriver().gripper("192.0.2.1", ROBOTIQ_2F85, {}).name == "robotiq_2f85 at 192.0.2.1"


def test_a_share_of_the_speed_is_a_limit_of_the_device() -> None:
    arm = UrDriver().arm("192.0.2.1", UR5E, {"speed": 0.05})
    assert arm.limits.joint_velocity == pytest.approx(0.05 * np.array(UR5E.velocity_limit))


def test_a_wrong_address_is_a_fault_with_what_to_look_at() -> None:
    begin = time.monotonic()
    with pytest.raises(DeviceFault, match=r"127\.1\.1\.1: nothing listens on port 29999"):
        UrDriver().arm("127.1.1.1", UR5E, {}).open()
    assert time.monotonic() - begin < 3.0


def place() -> NDArray[np.float64]:
    """Return where the virtual robot is, over another connection."""
    with UrDriver().arm(ADDRESS, UR5E, CALM) as other:
        return other.state().joints


def answer(question: str) -> str:
    with Dashboard(ADDRESS) as dashboard:
        return dashboard.ask(question)


def test_the_time_that_a_script_takes_to_begin_is_not_that_of_a_point(
    virtual: VirtualProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    took: list[float] = []
    write = UrArm._write

    def timed(arm: UrArm, point: StreamPoint) -> None:
        begin = time.monotonic()
        write(arm, point)
        took.append(time.monotonic() - begin)

    monkeypatch.setattr(UrArm, "_write", timed)
    firsts: list[float] = []
    for _ in range(3):
        with UrDriver().arm(ADDRESS, UR5E, {"watchdog": 2}) as arm:
            arm.recover()
            took.clear()
            arm.command_joints(arm.state().joints)
            wait_until(lambda: len(took) > 20)
            firsts.append(took[0])
    assert min(firsts) < 0.02  # the machine may be busy
