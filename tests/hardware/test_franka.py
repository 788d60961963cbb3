"""An FR3, through the vendor's interface and `franky-control` as installed, before a virtual robot."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Generator

import numpy as np
import pytest
from moving import PERIOD, stream, wait_until, wave
from virtual_fr3 import ADDRESS, STIFF, TROUBLES, an_arm, virtual_fr3

import rcs
from rcs.errors import DeviceFault, InvalidAction, InvalidSetup, MissingDependency
from rcs.hardware.franka import FrankaArm, FrankaDriver, FrankaOptions
from rcs.hardware.franka_faults import _WORDS  # pyright: ignore[reportPrivateUsage]
from rcs.hardware.franka_hand import FrankaHand
from rcs.kinematics import kinematics_of
from rcs.robots import FR3, FRANKA_HAND, Compliance
from rcs.spatial import Pose
from rcs.testing import ArmContract
from rcs.virtual import VirtualProcess

pytest.importorskip("franky", reason="needs franky-control, the extra 'franka'")
pytestmark = pytest.mark.hardware

_SILENT: list[int] = []


@pytest.fixture(scope="module")
def robot() -> Generator[VirtualProcess]:
    with virtual_fr3() as process:
        yield process


@pytest.fixture(autouse=True)
def _mended(robot: VirtualProcess) -> Generator[None]:
    robot.tell("clear")
    yield
    robot.tell("clear")


@pytest.fixture
def arm(robot: VirtualProcess) -> Generator[FrankaArm]:
    with an_arm() as arm:
        yield arm


class TestFrankaArm(ArmContract):  # without the loss of the link: one that was cut does not answer again
    tolerance = 6e-3  # a spring
    stopping_time = 0.5
    speed_margin = 1.25  # springs pull harder after a delay

    @pytest.fixture(autouse=True)
    def _robot(self, robot: VirtualProcess) -> None:
        self.robot = robot
        robot.tell("clear")
        an_arm().close()

    def make_device(self) -> FrankaArm:
        return FrankaArm(ADDRESS, FR3, STIFF)

    def provoke_fault(self, device) -> None:
        self.robot.tell("reflex")
        wait_until(lambda: device.fault)


# --- Connecting


def test_an_address_where_nobody_is_is_told_with_what_to_look_at():
    arm = FrankaArm("127.0.52.99", FR3)
    began = time.monotonic()
    with pytest.raises(DeviceFault, match=r"127\.0\.52\.99.*refused.*cable.*FCI.*other program"):
        arm.open()
    assert time.monotonic() - began < 3.0


@pytest.mark.parametrize("device", [FrankaArm("127.0.52.98", FR3), FrankaHand("127.0.52.98", FRANKA_HAND)])
def test_a_peer_that_says_nothing_is_given_up_while_other_threads_run(device):
    ticks: list[float] = []
    is_over = threading.Event()

    def count() -> None:
        while not is_over.wait(0.01):
            ticks.append(time.monotonic())

    thread = threading.Thread(target=count)
    if not _SILENT:  # they stay as long as the process: the library's call goes on, and would be busy without them
        _SILENT.extend(socket.create_server(("127.0.52.98", port)).detach() for port in (1337, 1338))
    thread.start()
    began = time.monotonic()
    with pytest.raises(DeviceFault, match=r"127\.0\.52\.98.*not answered within.*cable"):
        device.open()
    taken = time.monotonic() - began
    is_over.set()
    thread.join()
    assert taken < 3.0
    assert np.diff(ticks).max() < 1.0


def test_a_robot_of_another_version_is_told_with_both(robot: VirtualProcess):
    robot.tell("version", 9)
    with pytest.raises(DeviceFault, match=r"server version: 9.*library version: 10.*franky-control"):
        FrankaArm(ADDRESS, FR3).open()


def test_options_that_make_no_sense_are_refused_by_name():
    driver = FrankaDriver()
    with pytest.raises(InvalidSetup, match=r"sped.*speed"):
        driver.arm(ADDRESS, FR3, {"sped": 0.5})
    with pytest.raises(InvalidSetup, match="a sequence of 7"):
        driver.arm(ADDRESS, FR3, {"collision_torque": [100] * 6})
    with pytest.raises(InvalidSetup, match="valid for Franka Research 3 is one, or 7"):
        driver.arm(ADDRESS, FR3, {"compliance": Compliance(joints=(100,) * 6)})
    with pytest.raises(InvalidSetup, match="speed is 5"):
        driver.arm(ADDRESS, FR3, {"speed": 5})
    with pytest.raises(InvalidSetup, match="set it in the setup"):
        rcs.make("Free", hardware={"fr3": {"driver": "franka", "options": {"compliance": "soft"}}})
    with pytest.raises(InvalidSetup, match="force"):
        driver.gripper(ADDRESS, FRANKA_HAND, {"force": 3})


def test_a_missing_library_is_told_with_its_extra(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "franky", None)
    with pytest.raises(MissingDependency, match=r"robot-control-stack\[franka\]"):
        FrankaArm(ADDRESS, FR3).open()


# --- Reading and moving


def test_what_is_read_is_where_the_virtual_robot_stands(arm: FrankaArm):
    state = arm.state()
    assert (state.joints > arm.limits.joint_lower).all()
    assert state.joint_velocities == pytest.approx(np.zeros(7), abs=1e-2)
    assert state.wrench == pytest.approx(np.zeros(6), abs=1.0)
    assert state.mode == "Idle", "to open it energises nothing"
    own = Pose.from_matrix(np.array(arm._robot.state.O_T_EE.matrix))
    assert kinematics_of(FR3, FRANKA_HAND).forward(state.joints).is_close(own, 1e-4, 1e-4)
    assert state.time <= time.monotonic()
    later = arm.state()
    wait_until(lambda: arm.state().device_time > later.device_time)


def test_a_first_target_far_away_is_refused_and_nothing_moves(arm: FrankaArm):
    before = arm.state().joints
    with pytest.raises(InvalidAction, match=r"0\.5 rad away"):
        arm.command_joints(before + [0, 0, 0.5, 0, 0, 0, 0])
    time.sleep(0.1)
    assert arm.state().mode == "Idle"
    assert arm.state().joints == pytest.approx(before, abs=1e-3)


@pytest.mark.parametrize("compliance", [None, Compliance(tcp=(1000, 60))])
def test_a_stream_of_targets_is_followed(robot: VirtualProcess, compliance):
    """The arm is behind the targets by the same time everywhere."""
    options = FrankaOptions(compliance=compliance, collision_force=400.0, collision_torque=(80.0,) * 7)
    with an_arm(options) as arm:
        targets = wave(arm)
        measured = stream(arm, np.concatenate([targets, np.repeat(targets[-1:], 30, 0)]))
        assert arm.fault == ""
        assert arm.state().mode == "Move"
        if compliance is None:
            apart = [np.abs(measured[lag : lag + len(targets)] - targets).max() for lag in range(8)]
            assert min(apart) < 0.03, "half a period of the stream is 0.01"
            assert measured[-1] == pytest.approx(targets[-1], abs=2e-3)
            return
        kinematics = kinematics_of(FR3, FRANKA_HAND)
        ways = [[kinematics.forward(one).translation for one in many] for many in (measured, targets)]
        apart = [np.abs(np.array(ways[0][lag : lag + len(targets)]) - ways[1]).max() for lag in range(8)]
        assert min(apart) < 0.015
        assert kinematics.forward(measured[-1]).is_close(kinematics.forward(targets[-1]), 3e-3, 1e-2)


def settle(arm) -> None:
    """Wait until a push has moved the arm as far as it does."""
    time.sleep(0.5)
    wait_until(lambda: np.abs(arm.state().joint_velocities).max() < 2e-4)


@pytest.mark.parametrize("compliance", [Compliance(joints=200), Compliance(tcp=(1000, 60))], ids=["joints", "tcp"])
def test_a_push_moves_it_by_force_over_stiffness(robot: VirtualProcess, compliance):
    kinematics = kinematics_of(FR3, FRANKA_HAND)
    with an_arm(FrankaOptions(compliance=compliance, collision_force=400.0, collision_torque=(80.0,) * 7)) as arm:
        led = arm.state().joints
        arm.command_joints(led)
        time.sleep(1.0)
        before = arm.state().joints
        for force in (10.0, 0.0, 0.0), (0.0, -10.0, 0.0), (5.0, 6.0, 8.0):
            robot.tell("push", *force)
            settle(arm)
            here = arm.state().joints
            if compliance.is_of_tcp:
                moved = np.array(kinematics.forward(here).translation) - kinematics.forward(before).translation
                expected = np.array(force) / 1000.0
            else:
                moved, expected = here - before, kinematics.jacobian(here)[:3].T @ force / 200.0
            assert np.linalg.norm(moved - expected) < 0.02 * np.linalg.norm(expected)
        robot.tell("clear")
        settle(arm)
        assert arm.state().joints == pytest.approx(before, abs=1e-3)
        assert arm.fault == ""


def test_a_hard_stop_by_something_in_the_way_is_a_fault_with_its_direction(robot: VirtualProcess):
    """The arm is led into the table."""
    kinematics = kinematics_of(FR3, FRANKA_HAND)
    with an_arm(FrankaOptions(collision_force=30.0)) as arm:
        stream(arm, np.linspace(arm.state().joints, FR3.home, 60))
        start = joints = np.array(FR3.home)
        pose = kinematics.forward(joints)
        above, below = [0.5, 0.0, 0.2], [0.5, 0.0, -0.1]
        for place in [*np.linspace(pose.translation, above, 60), *np.linspace(above, below, 90)]:
            joints = kinematics.inverse(Pose(place, pose.quaternion), joints).joints
            try:
                arm.command_joints(joints, valid_for=1.0)
            except DeviceFault:
                break
            time.sleep(PERIOD)
        assert "cartesian_reflex" in arm.fault
        assert "pushed against the tool" in arm.fault
        before = arm.state().joints
        arm.recover()
        time.sleep(0.3)
        assert arm.state().joints == pytest.approx(before, abs=5e-3)
        stream(arm, np.linspace(before, start, 60))


def test_a_fault_while_an_arm_is_guided_that_was_led_before_is_told(arm: FrankaArm, robot: VirtualProcess):
    stream(arm, wave(arm)[:5])
    arm.hold()
    wait_until(arm.has_arrived)
    arm.guide(True)
    robot.tell("user_stop")
    wait_until(lambda: "user stop" in arm.fault)


def test_a_person_guides_the_arm_which_then_stays(arm: FrankaArm):
    assert arm.can_guide
    arm.guide(True)
    time.sleep(0.2)
    assert arm.state().mode == "Move"
    before = arm.state().joints
    arm.guide(False)
    arm.command_joints(arm.state().joints)
    time.sleep(0.3)
    assert arm.state().joints == pytest.approx(before, abs=0.02)


# --- Faults


@pytest.mark.parametrize(("words", "told"), TROUBLES)
def test_what_goes_wrong_is_told_in_words_at_once_and_recover_moves_nothing(
    robot: VirtualProcess, arm: FrankaArm, words, told
):
    targets = wave(arm)
    stream(arm, targets[:10])
    robot.tell(*words)
    began = time.monotonic()
    try:
        while not arm.fault and time.monotonic() < began + 3.0:
            arm.state()
            time.sleep(0.002)
    except DeviceFault:
        pass
    taken = time.monotonic() - began
    assert re.search(told, arm.fault), arm.fault
    assert taken < 1.0  # 0.1 s, or 0.3 s where the controller hangs, on a machine that is not busy
    with pytest.raises(DeviceFault):
        arm.command_joints(targets[10])
    time.sleep(1.5 if words[0] in ("freeze", "cut") else 0.5)
    robot.tell("clear")
    arm.recover()
    assert arm.fault == ""
    before = arm.state().joints
    time.sleep(0.3)
    assert arm.state().joints == pytest.approx(before, abs=2e-3)
    arm.command_joints(arm.state().joints)


def test_an_arm_found_in_a_reflex_opens_with_that_fault_and_is_recovered(robot: VirtualProcess):
    robot.tell("reflex")
    arm = an_arm(is_well=False)
    with arm:
        wait_until(lambda: arm.fault)
        assert "joint_reflex" in arm.fault
        arm.recover()
        assert arm.fault == ""


def test_an_arm_whose_program_is_killed_brakes(robot: VirtualProcess, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        "import time, numpy as np\n"
        "from rcs.hardware.franka import FrankaArm\n"
        "from rcs.robots import FR3\n"
        f"arm = FrankaArm({ADDRESS!r}, FR3)\n"
        "arm.open()\n"
        "start = arm.state().joints\n"
        "print('moving', flush=True)\n"
        "for step in range(1000):\n"
        "    arm.command_joints(start + 0.3 * np.sin(step / 10) * np.eye(7)[0], valid_for=0.2)\n"
        "    time.sleep(1 / 30)\n"
    )
    with subprocess.Popen([sys.executable, program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "moving\n"
        time.sleep(0.5)
        process.send_signal(signal.SIGKILL)
    arm = an_arm(is_well=False)
    with arm:
        wait_until(lambda: arm.fault)
        assert "communication_constraints_violation" in arm.fault
        before = arm.state().joints
        time.sleep(0.2)
        assert arm.state().joints == pytest.approx(before, abs=1e-3)
        arm.recover()


def test_the_errors_that_have_words_are_those_of_the_library():
    import franky

    assert set(_WORDS) <= set(dir(franky.Errors))
