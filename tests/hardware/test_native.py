"""Poses and twists that the controllers of virtual robots lead the TCP by, with `native` in the setup."""

from __future__ import annotations

import importlib.util
import json
import os
import time
from collections.abc import Generator
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.env import Env
from rcs.envs.setup import Setup
from rcs.errors import DeviceFault, InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.spatial import Pose
from rcs.virtual import VirtualProcess

pytestmark = [
    pytest.mark.hardware,
    pytest.mark.filterwarnings("ignore:The 'warn' method:DeprecationWarning"),  # of the xArm's library
]

NET = f"127.{64 + (os.getpid() >> 8) % 64}.{os.getpid() % 250 + 1}"
TCP = [0.0, 0.0, 0.1553, 0.0, 0.0, 0.0, 1.0]
# Slow enough for a busy machine without real-time priority: late ticks and the watchdog are not what is tested here.
UR5E: dict[str, Any] = {"driver": "ur", "address": f"{NET}.12", "options": {"rate": 125, "watchdog": 2, "tcp": TCP}}
XARM7: dict[str, Any] = {"driver": "xarm", "address": f"{NET}.22", "options": {"rate": 100, "tcp": TCP}}
FREQUENCY = 20.0
OFF = 4e-3, 1e-2
"""How far a virtual arm may be from the pose that it was sent [m, rad]: as in the tests of the drivers."""


@pytest.fixture(scope="module", params=[("ur5e", UR5E, "rtde_control"), ("xarm7", XARM7, "xarm")], ids=lambda p: p[0])
def virtual(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Generator[tuple[VirtualProcess, str, Any]]:
    """Give a virtual robot, its name, and how its arm is reached."""
    name, arm, library = request.param
    if importlib.util.find_spec(library) is None:
        pytest.skip(f"the extra `{arm['driver']}` is not installed")
    setup = tmp_path_factory.mktemp("native") / "setup.json"
    setup.write_text(json.dumps(Setup(task="Free", robot=name, end_effector="robotiq_2f85").to_json()))
    try:
        with VirtualProcess(name, address=arm["address"], setup=setup) as process:
            yield process, name, arm
    except InvalidSetup as err:
        if "ip_unprivileged_port_start" not in str(err):
            raise
        pytest.skip(str(err))


@pytest.fixture
def robot(virtual: tuple[VirtualProcess, str, Any]) -> tuple[str, Any]:
    """Return a virtual robot's name, and how its arm is reached."""
    return virtual[1:]


def make(robot: tuple[str, Any], **options: Any) -> Env:
    name, arm = robot
    hardware = {name: arm, f"{name}/gripper": "fake"}
    carried = {"end_effector": "robotiq_2f85", **options}
    return rcs.make("Free", robot=name, native=True, hardware=hardware, frequency=FREQUENCY, **carried)


def action(**arm: Any) -> dict[str, Any]:
    return {**arm, "gripper": np.ones(1, np.float32)}


def recover(env: Env) -> None:
    limit = time.monotonic() + 10.0  # a protective stop stays for 5 s
    while True:
        try:
            return env.recover()
        except DeviceFault:
            assert time.monotonic() < limit
            time.sleep(0.5)


def test_the_pose_reached_is_the_pose_that_was_sent(robot: tuple[str, Any]) -> None:
    with make(robot, control="tquat", relative="absolute") as env:
        observation, _ = env.reset()
        start = Pose.from_tquat(observation["tquat"])
        for way in ([0.03, 0.04, -0.05], [0.0, 0.0, 0.0]):
            goal = Pose(start.translation + way, start.quaternion) * Pose.from_rpy([0.0, 0.0, 0.0], [0.1, 0.0, 0.2])
            for _ in range(50):
                observation, _, _, truncated, info = env.step(action(tquat=goal.tquat))
                assert not truncated, info
            assert env.stack.executed["tquat"] == pytest.approx(goal.tquat)
            assert Pose.from_tquat(observation["tquat"]).is_close(goal, *OFF)


def test_after_a_fault_on_its_way_the_first_pose_counts_from_where_the_arm_is(
    virtual: tuple[VirtualProcess, str, Any], robot: tuple[str, Any]
) -> None:
    process = virtual[0]
    with make(robot, control="tquat", relative="absolute") as env:
        start, _ = env.reset()
        goal = Pose.from_tquat(start["tquat"] + [0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
        is_told = False
        while True:
            observation, _, _, truncated, _ = env.step(action(tquat=goal.tquat))
            if truncated:
                break
            if not is_told and np.linalg.norm(observation["tquat"][:3] - start["tquat"][:3]) > 0.03:
                process.tell("reflex")
                is_told = True
        process.tell("clear")
        time.sleep(0.5)
        recover(env)
        stands, _ = env.reset()
        for _ in range(10):
            observation, _, _, truncated, info = env.step(action(tquat=stands["tquat"]))
            assert not truncated, info
            assert observation["tquat"][:3] == pytest.approx(stands["tquat"][:3], abs=OFF[0])


def test_relative_poses_add_up(robot: tuple[str, Any]) -> None:
    with make(robot, control="xyzrpy") as env:
        first, _ = env.reset()
        for _ in range(20):
            env.step(action(xyzrpy=np.array([0.0, 0.002, 0.0, 0.0, 0.0, 0.0])))
        for _ in range(10):
            observation, _, _, truncated, info = env.step(action(xyzrpy=np.zeros(6)))
            assert not truncated, info
        assert observation["tquat"][:3] - first["tquat"][:3] == pytest.approx([0.0, 0.04, 0.0], abs=OFF[0])


@pytest.mark.parametrize("axis", [1, 2])
def test_a_twist_moves_the_tcp_at_its_velocity_and_no_longer_than_it_lives(robot: tuple[str, Any], axis: int) -> None:
    if robot[0] == "xarm7":
        with pytest.raises(InvalidSetup, match="takes joints, pose"):
            make(robot, control="twist")
        return
    twist = np.zeros(6)
    twist[axis] = 0.05
    for sign in (1.0, -1.0):
        with make(robot, control="twist") as env:
            observation, _ = env.reset()
            placement = env.robots[robot[0]]
            velocities = []  # by the controller's clock: a machine that is busy passes less of the robot's time
            start, kinematics = observation["tquat"], kinematics_of(placement.arm, placement.end_effector)
            for _ in range(30):
                observation, _, _, truncated, info = env.step(action(twist=sign * twist))
                assert not truncated, info
                velocities.append(kinematics.jacobian(observation["joints"]) @ observation["joint_velocities"])
            assert np.median(velocities, axis=0) == pytest.approx(sign * twist, abs=1e-3)
            moved = observation["tquat"][:3] - start[:3]
            assert moved / np.linalg.norm(moved) == pytest.approx(np.sign(sign * twist[:3]), abs=0.02)
            (arm,) = (port.device for port in env.stack.ports if port.joint_space is not None)
            time.sleep(3 / FREQUENCY + 0.5)  # its time to live, and to brake
            stands = arm.state().joints
            time.sleep(0.2)
            assert arm.state().joints == pytest.approx(stands, abs=1e-3)
            assert not arm.fault


def test_the_arm_goes_home_by_joints_after_it_was_led_by_its_controller(robot: tuple[str, Any]) -> None:
    with make(robot, control="xyzrpy") as env:
        env.reset()
        for _ in range(20):
            env.step(action(xyzrpy=np.array([0.0, 0.0, 0.002, 0.0, 0.0, 0.0])))
        home = np.array(env.robots[robot[0]].arm.home)
        observation, _ = env.reset(options={"robot": {"joints": home}, "may_move": True, "speed": 0.2})
        assert observation["joints"] == pytest.approx(home, abs=5e-3)
        for _ in range(5):
            observation, _, _, truncated, info = env.step(action(xyzrpy=np.zeros(6)))
            assert not truncated, info
        assert observation["joints"] == pytest.approx(home, abs=5e-3)


def test_a_guard_and_an_arm_without_a_tcp_are_refused(robot: tuple[str, Any]) -> None:
    with pytest.raises(InvalidSetup, match="looks at joints"):
        make(robot, control="tquat", gates=["Guard"])
    name, arm = robot
    bare = {**arm, "options": {}}
    with pytest.raises(InvalidSetup, match=r"'tcp', give it: \[0, 0, 0\.1553, 0, 0, 0, 1\]"):
        make((name, bare), control="tquat")
