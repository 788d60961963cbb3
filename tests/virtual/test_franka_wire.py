"""The controller of an FR3 as a client sees it that speaks the protocol and nothing else."""

from __future__ import annotations

import re
import time
from collections.abc import Generator

import mujoco
import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.hardware.franka_limits import velocity_bounds
from rcs.kinematics import kinematics_of, load
from rcs.robots import FR3, FRANKA_HAND
from rcs.spatial import Pose
from rcs.virtual import VirtualProcess
from rcs.virtual.franka_client import Listener
from rcs.virtual.franka_generators import PERIOD, MotionGenerator, motion_errors, torque_errors
from rcs.virtual.franka_messages import (
    ARM_COMMAND,
    ARM_HEADER,
    ARM_PORT,
    ARM_STATE,
    HAND_HEADER,
    HAND_PORT,
    HAND_REQUESTS,
    HAND_STATE,
    REQUESTS,
    Command,
    Controller,
    Error,
    GeneratorMode,
    HandCommand,
    HandStatus,
    Mode,
    MoveStatus,
)
from rcs.virtual.franka_model import Carried, urdf_of
from rcs.virtual.line import Line
from tests.virtual.franka_client import ADDRESS, Client

HOME = np.array(FR3.home)
KINEMATICS = kinematics_of(FR3, FRANKA_HAND)


def a_hand() -> Client:
    return Client(HAND_PORT, HAND_HEADER, HAND_STATE, HAND_REQUESTS, version=3)


@pytest.fixture(scope="module")
def robot() -> Generator[VirtualProcess]:
    with VirtualProcess("fr3", address=ADDRESS) as process:
        yield process


@pytest.fixture
def client(robot: VirtualProcess) -> Generator[Client]:
    robot.tell("clear")
    with Client() as client:
        assert client.connect() == bytes([0, 10, 0])
        client.recover()
        yield client


def errors_of(state) -> set[str]:
    return {error.name for error in Error if state["errors"][error]}


def mode_after(client: Client, mode: Mode):
    for _ in range(3000):
        if (state := client.state())["robot_mode"] == mode:
            return state
    raise AssertionError(f"never in mode {mode.name}")


# --- Messages


def test_a_state_and_a_command_are_as_long_as_those_of_the_vendors_library():
    sizes = [kind.itemsize for kind in (ARM_STATE, ARM_COMMAND, REQUESTS[Command.MOVE], HAND_STATE)]
    assert sizes == [1377, 371, 113, 23]


def test_a_state_tells_what_the_simulated_robot_does(client: Client):
    first, state = client.state(), client.state()
    assert state["message_id"] > first["message_id"]
    assert state["q"] == pytest.approx(HOME, abs=1e-3)
    pose = KINEMATICS.forward(np.array(state["q"], float))
    assert pytest.approx(pose.matrix, abs=1e-5) == np.array(state["O_T_EE"]).reshape(4, 4).T
    flange_to_tcp = np.array(state["F_T_EE"]).reshape(4, 4).T
    assert flange_to_tcp == pytest.approx(Carried.of(FRANKA_HAND).pose_tcp_in_flange.matrix, abs=1e-6)
    assert state["m_ee"] == pytest.approx(0.7126, abs=1e-4)
    assert state["robot_mode"] == Mode.IDLE
    assert errors_of(state) == set()
    assert np.abs(state["O_F_ext_hat_K"]).max() < 1.0
    assert np.abs(state["tau_J"][3]) > 10.0, "the weight of the forearm"


def test_a_damaged_state_does_not_arrive(robot: VirtualProcess, client: Client):
    mounting = ["F_T_NE", "NE_T_EE", "F_T_EE", "EE_T_K"]  # which nothing changes
    first = client.state()
    robot.tell("corrupt", "1/2")
    for _ in range(200):
        state = client.state()
        assert all((state[name] == first[name]).all() for name in mounting)
    robot.tell("clear")


def test_the_model_has_the_masses_and_the_frames_of_the_simulated_arm():
    given = mujoco.MjModel.from_xml_string(urdf_of(FR3))
    own = load(FR3).compile()
    data, want = mujoco.MjData(given), mujoco.MjData(own)
    data.qpos[:], want.qpos[:] = HOME, HOME
    mujoco.mj_forward(given, data)
    mujoco.mj_forward(own, want)
    masses = np.zeros((2, 7, 7))
    mujoco.mj_fullM(given, data, masses[0])
    mujoco.mj_fullM(own, want, masses[1])
    assert masses[0] == pytest.approx(masses[1] - np.diag(own.dof_armature), abs=1e-5)
    assert data.qfrc_bias == pytest.approx(want.qfrc_bias, abs=1e-4)


# --- Connecting


def test_another_version_is_told_which_one_the_robot_speaks(robot: VirtualProcess, client: Client):
    client.tcp.close()
    time.sleep(0.1)
    robot.tell("version", 9)
    try:
        with pytest.raises(InvalidSetup, match="valid is a whole number from 0 to 65535"):
            robot.tell("version", 65536)
        with Client() as other:
            assert other.connect() == bytes([1, 9, 0])
    finally:
        robot.tell("clear")


def test_a_second_client_waits_until_the_first_is_gone(client: Client):
    with Client() as other:
        other.tcp.settimeout(0.3)
        with pytest.raises(TimeoutError):
            other.connect()
        assert client.state()["robot_mode"] == Mode.IDLE
        client.tcp.close()
        assert other.answer() == (1, bytes([0, 10, 0]))


def test_what_is_not_of_the_protocol_ends_the_connection_and_nothing_else(client: Client):
    with a_hand() as hand:
        hand.tcp.sendall(b"\xff" * 100)
        with pytest.raises((EOFError, ConnectionError)):
            hand.take(1)
    assert client.state()["robot_mode"] == Mode.IDLE


def test_an_address_that_is_taken_is_refused(robot: VirtualProcess):
    with pytest.raises(InvalidSetup, match=rf"Port 1337.*{re.escape(ADDRESS)}.*another address"):
        Listener(Line(), ADDRESS, ARM_PORT, ARM_HEADER, REQUESTS)


# --- Motions


def test_torques_push_the_arm_and_end_when_they_are_said_to(client: Client):
    number = client.start_torques()
    start = client.next_state()
    for tick in range(200):
        state = client.next_state()
        push = 5.0 * np.sin(np.pi * tick / 200)
        client.command(state, tau_J_d=[0, 0, 0, 0, 0, 0, 0.1 * push])
    client.command(client.next_state(), torque_command_finished=1)
    assert client.answer() == (number, bytes([MoveStatus.SUCCESS]))
    end = mode_after(client, Mode.IDLE)
    assert end["q"][6] > start["q"][6] + 0.01
    assert end["q"][:6] == pytest.approx(start["q"][:6], abs=0.02)


def test_torques_that_jump_are_a_reflex_until_it_is_recovered(client: Client):
    number = client.start_torques()
    client.command(client.next_state(), tau_J_d=[5.0, 0, 0, 0, 0, 0, 0])
    assert client.answer() == (number, bytes([MoveStatus.REFLEX_ABORTED]))
    state = mode_after(client, Mode.REFLEX)
    assert errors_of(state) == {"CONTROLLER_TORQUE_DISCONTINUITY"}
    refused = client.send(Command.MOVE, controller_mode=Controller.EXTERNAL, motion_generator_mode=4)
    assert client.answer() == (refused, bytes([MoveStatus.NOT_POSSIBLE]))
    client.recover()
    state = client.state()
    assert (state["robot_mode"], errors_of(state)) == (Mode.IDLE, set())
    assert state["reflex_reason"][Error.CONTROLLER_TORQUE_DISCONTINUITY], "of the last motion"


def test_a_client_that_falls_silent_loses_its_motion(client: Client):
    number = client.start_torques()
    for _ in range(30):
        client.command(client.next_state())
    assert client.answer() == (number, bytes([MoveStatus.REFLEX_ABORTED]))
    state = mode_after(client, Mode.REFLEX)
    assert errors_of(state) == {"COMMUNICATION_CONSTRAINTS_VIOLATION"}


def test_a_client_that_goes_leaves_an_arm_that_the_next_one_recovers(robot: VirtualProcess, client: Client):
    client.start_torques()
    client.command(client.next_state())
    client.tcp.close()
    time.sleep(0.2)
    with Client() as other:
        assert other.connect()[0] == 0
        assert errors_of(other.state()) == {"COMMUNICATION_CONSTRAINTS_VIOLATION"}
        other.recover()


def test_a_stop_ends_the_motion_as_preempted(client: Client):
    number = client.start_torques()
    for _ in range(5):
        client.command(client.next_state())
    stop = client.send(Command.STOP_MOVE)
    assert dict([client.answer(), client.answer()]) == {number: bytes([MoveStatus.PREEMPTED]), stop: b"\0"}
    assert mode_after(client, Mode.IDLE)["controller_mode"] == Controller.OTHER


@pytest.mark.parametrize("code", ["user_stop", "brakes"])
def test_who_presses_the_stop_or_locks_the_joints_ends_motions_until_they_let_go(robot, client: Client, code: str):
    number = client.start_torques()
    client.command(client.next_state())
    robot.tell(code)
    assert client.answer() == (number, bytes([MoveStatus.EMERGENCY_ABORTED]))
    mode_after(client, Mode.USER_STOPPED if code == "user_stop" else Mode.OTHER)
    assert client.ask(Command.AUTOMATIC_ERROR_RECOVERY) != b"\0"
    robot.tell("clear")
    mode_after(client, Mode.IDLE)


def test_a_reflex_says_what_was_pushed_and_a_code_what_it_means(robot: VirtualProcess, client: Client):
    robot.tell("reflex")
    state = mode_after(client, Mode.REFLEX)
    assert errors_of(state) == {"JOINT_REFLEX"}
    assert list(state["joint_collision"]) == [0, 0, 0, 1, 0, 0, 0]
    client.recover()
    assert not client.state()["joint_collision"].any()
    robot.tell("code", int(Error.POWER_LIMIT_VIOLATION))
    assert errors_of(mode_after(client, Mode.REFLEX)) == {"POWER_LIMIT_VIOLATION"}
    with pytest.raises(InvalidSetup, match="0 to 40"):
        robot.tell("code", 41)


def test_settings_are_checked(client: Client):
    ok, invalid = b"\0", b"\x02"
    assert client.ask(Command.SET_JOINT_IMPEDANCE, stiffness=[3000] * 7) == ok
    assert client.ask(Command.SET_JOINT_IMPEDANCE, stiffness=[-1] * 7) == invalid
    assert client.ask(Command.SET_CARTESIAN_IMPEDANCE, stiffness=[3000] * 3 + [300] * 3) == ok
    assert client.ask(Command.SET_CARTESIAN_IMPEDANCE, stiffness=[3000] * 6) == invalid
    assert client.ask(Command.SET_LOAD, mass=0.5, center=[0, 0, 0.1], inertia=np.eye(3).ravel() * 1e-3) == ok
    assert client.state()["m_load"] == 0.5
    assert client.ask(Command.SET_LOAD, mass=np.nan) == invalid
    assert client.state()["m_load"] == 0.5
    assert client.ask(Command.SET_LOAD, mass=0.0) == ok


# --- The hand


def test_a_hand_moves_grasps_the_air_and_is_stopped(robot: VirtualProcess):
    with a_hand() as hand:
        assert hand.connect() == bytes([0, 0, 3, 0])
        assert hand.state()["max_width"] == pytest.approx(0.08)
        assert hand.ask(HandCommand.MOVE, width=0.03, speed=0.1) == bytes([HandStatus.SUCCESS, 0])
        assert hand.state()["width"] == pytest.approx(0.03, abs=2e-3)
        assert hand.ask(HandCommand.MOVE, width=0.2, speed=0.1) == bytes([HandStatus.FAIL, 0])
        nothing = hand.ask(HandCommand.GRASP, width=0.03, inner=0.005, outer=0.005, speed=0.1, force=20)
        assert nothing == bytes([HandStatus.UNSUCCESSFUL, 0])
        assert not hand.state()["is_grasped"]
        moving = hand.send(HandCommand.MOVE, width=0.08, speed=0.05)
        time.sleep(0.2)
        stop = hand.send(HandCommand.STOP)
        assert dict([hand.answer(), hand.answer()]) == {moving: bytes([HandStatus.ABORTED, 0]), stop: b"\0\0"}
        assert hand.state()["width"] < 0.06
        assert hand.ask(HandCommand.HOMING) == b"\0\0"
        assert hand.state()["width"] == pytest.approx(0.08, abs=2e-3)


# --- What is refused, without a wire


def generator_at(mode: GeneratorMode, joints=HOME) -> MotionGenerator:
    return MotionGenerator(mode, FR3, KINEMATICS, np.array(joints))


def a_command(**fields):
    command = np.zeros((), ARM_COMMAND)
    for name, value in fields.items():
        command[name] = value
    return command


def ramp(jerk: float, ticks: int) -> list[np.ndarray]:
    """Positions of a joint that gains speed, keeps it, and loses it again, all with one jerk."""
    jerks = np.repeat([jerk, -jerk, -jerk, jerk], ticks)
    accelerations = np.cumsum(jerks) * PERIOD
    velocities = np.cumsum(accelerations) * PERIOD
    return list(np.cumsum(velocities) * PERIOD)


def test_a_smooth_motion_of_the_joints_is_followed():
    generator = generator_at(GeneratorMode.JOINT_POSITION)
    for way in ramp(jerk=100.0, ticks=80):
        assert generator.take(a_command(q_c=HOME + way)) == []
    assert generator.joints[0] > 0.03
    assert generator.velocities == pytest.approx(np.zeros(7), abs=1e-9)


@pytest.mark.parametrize(
    ("name", "joints"),
    [
        ("START_POSE_INVALID", HOME + 0.01),
        ("VELOCITY_DISCONTINUITY", HOME + 5e-5),
        ("ACCELERATION_DISCONTINUITY", HOME + 9e-6),
    ],
)
def test_joints_that_jump_are_refused_by_name(name, joints):
    errors = generator_at(GeneratorMode.JOINT_POSITION).take(a_command(q_c=joints))
    assert any(name in error.name for error in errors)


@pytest.mark.parametrize(
    ("mode", "fields"),
    [
        (GeneratorMode.JOINT_POSITION, {"q_c": np.nan}),
        (GeneratorMode.JOINT_VELOCITY, {"dq_c": np.nan}),
        (GeneratorMode.CARTESIAN_POSITION, {"O_T_EE_c": np.nan}),
        (GeneratorMode.CARTESIAN_VELOCITY, {"O_dP_EE_c": np.nan}),
        (GeneratorMode.CARTESIAN_VELOCITY, {"elbow_c": np.nan, "valid_elbow": 1}),
    ],
)
def test_values_that_are_no_numbers_are_errors(mode, fields):
    assert generator_at(mode).take(a_command(**fields))


def test_joints_that_leave_their_range_or_near_its_end_too_fast_are_refused():
    generator = generator_at(GeneratorMode.JOINT_VELOCITY, [0, 1.7836, 0, -2, 0, 2, 0])
    names: set[str] = set()
    for tick in range(200):
        names |= {error.name for error in generator.take(a_command(dq_c=[0, 0.004 * tick, 0, 0, 0, 0, 0]))}
    assert {
        "JOINT_MOTION_GENERATOR_POSITION_LIMITS_VIOLATION",
        "JOINT_MOTION_GENERATOR_VELOCITY_LIMITS_VIOLATION",
    } == names
    least, most = velocity_bounds(FR3, np.array([0, 1.7, 0, -2, 0, 2, 0]))
    assert least[1] == -2.62
    assert most[1] == pytest.approx(np.sqrt(2 * 2.585 * 0.0837) - 0.2)


def test_a_pose_that_moves_smoothly_is_followed_and_one_that_jumps_is_not():
    generator = generator_at(GeneratorMode.CARTESIAN_POSITION)
    start = KINEMATICS.forward(HOME)
    for way in ramp(jerk=20.0, ticks=80):
        pose = Pose(start.translation + [0, 0, -way], start.quaternion)
        assert generator.take(a_command(O_T_EE_c=pose.matrix.T.ravel())) == []
    assert KINEMATICS.forward(generator.joints).is_close(pose, 1e-5, 1e-5)
    assert generator.joints[2] == pytest.approx(HOME[2], abs=1e-4), "the elbow stays"
    jumped = Pose(pose.translation + [0, 0, 1e-4], pose.quaternion)
    assert Error.CARTESIAN_MOTION_GENERATOR_VELOCITY_DISCONTINUITY in generator.take(
        a_command(O_T_EE_c=jumped.matrix.T.ravel())
    )
    broken = a_command(O_T_EE_c=2.0 * np.eye(4).ravel())
    assert generator.take(broken) == [Error.CARTESIAN_POSITION_MOTION_GENERATOR_INVALID_FRAME]


def test_a_command_that_comes_after_a_gap_is_measured_in_the_time_of_the_client():
    """The arm goes on meanwhile, at the same acceleration."""
    generator = generator_at(GeneratorMode.JOINT_VELOCITY)
    for tick in range(1, 101):
        assert generator.take(a_command(dq_c=np.full(7, 0.001 * tick))) == []
    generator.extrapolate()
    generator.extrapolate()
    assert generator.velocities == pytest.approx(np.full(7, 0.102))
    assert generator.take(a_command(dq_c=np.full(7, 0.103)), ticks=3) == []
    generator.extrapolate()
    assert generator.take(a_command(dq_c=np.full(7, 0.103)), ticks=3) == [], "it does not jump: one was only late"


def test_what_is_measured_is_watched_too():
    assert motion_errors(FR3, HOME, np.zeros(7)) == []
    assert motion_errors(FR3, HOME, np.full(7, 3.0)) == [Error.JOINT_VELOCITY_VIOLATION]
    beyond = np.array([2.8, *HOME[1:]])
    assert motion_errors(FR3, beyond, np.zeros(7)) == [Error.JOINT_POSITION_LIMITS_VIOLATION]
    assert torque_errors(FR3, np.full(7, 0.9), np.zeros(7), 1) == []
    assert torque_errors(FR3, np.full(7, 1.9), np.zeros(7), 2) == []
    assert torque_errors(FR3, np.full(7, 13.0), np.full(7, 12.5), 1) == [Error.TAU_J_RANGE_VIOLATION]
