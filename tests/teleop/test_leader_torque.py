"""Leader arms whose motors are on: gently, only after the robot, and never when nobody says where that is."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import Agent
from rcs.errors import DeviceFault, InvalidSetup
from rcs.robots.fr3 import FR3
from rcs.teleop import Leader, Operator, Takeover, gello
from rcs.teleop.leader import AHEAD, FRESH, PACE
from tests.teleop.leaders import COUNTS, STEP, Bus, bus_of, calibrated, leader_at, saved
from tests.teleop.scripted_device import ScriptedDevice, held

# They need pyserial and Feetech's library, which `make test-hardware` installs.
pytestmark = pytest.mark.hardware
pytest.importorskip("serial", reason="serial lines need pyserial: pip install 'robot-control-stack[leader]'")
pytest.importorskip("scservo_sdk", reason="an SO101 needs feetech-servo-sdk: pip install 'robot-control-stack[leader]'")

KINDS = pytest.mark.parametrize("kind", ["feetech", "dynamixel"])
MOST = {"feetech": 150, "dynamixel": 150}
"""Bounds of the torque, in units of the servos."""


def show(device: Leader, joints: np.ndarray, state: str = "held") -> np.ndarray:
    """Show where the robot is, and return where the leader then is."""
    device.feedback({"joints": joints}, {"operator": {"right": state}, "led": {"right": "robot"}})
    reading = device.read()
    assert reading is not None
    return np.array(reading.hands["right"].joints)


def with_torque(bus: Bus) -> set[str]:
    return {servo for servo, is_on in bus.tell()["torque"].items() if is_on}


def joints_of(bus: Bus) -> set[str]:
    return set(sorted(bus.tell()["torque"], key=int)[:-1])


@KINDS
def test_motors_stay_off_unless_torque_is_wanted(kind: str, tmp_path: Path) -> None:
    with bus_of(kind, COUNTS[kind]) as bus, leader_at(bus, kind, tmp_path) as device:
        device.open()
        before = device.read()
        assert before is not None
        joints = np.array(before.hands["right"].joints)
        for _ in range(10):
            assert np.array_equal(show(device, joints + 0.3), joints)
        assert not with_torque(bus)
        assert not device.has_clutch


@KINDS
def test_a_leader_follows_the_robot_slowly_with_a_bounded_torque_and_its_gripper_is_free(
    kind: str, tmp_path: Path
) -> None:
    with bus_of(kind, COUNTS[kind]) as bus, leader_at(bus, kind, tmp_path, torque=True) as device:
        device.open()
        first = device.read()
        assert first is not None
        start = np.array(first.hands["right"].joints)
        robot = start + 0.3 * np.resize([1.0, -1.0], len(start))
        begin, last = time.monotonic(), start
        for _ in range(400):
            now = show(device, robot)
            state = bus.tell()
            assert all(state["limits"][servo] == MOST[kind] for servo, is_on in state["torque"].items() if is_on)
            last = now
            if np.abs(now - robot).max() < 0.01:
                break
        assert np.abs(last - robot).max() < 0.01
        assert time.monotonic() - begin > 0.25 / PACE
        assert with_torque(bus) == joints_of(bus)


@KINDS
def test_a_leader_that_is_held_is_not_pulled_harder_for_being_far(kind: str, tmp_path: Path) -> None:
    with bus_of(kind, COUNTS[kind]) as bus, leader_at(bus, kind, tmp_path, torque=True) as device:
        device.open()
        first = device.read()
        assert first is not None
        start = np.array(first.hands["right"].joints)
        bus.tell(held=[1, 2])
        for _ in range(80):
            now = show(device, start + 0.6)
        assert now[:2] == pytest.approx(start[:2], abs=2 * STEP)
        state = bus.tell()
        for servo in ("1", "2"):
            assert abs(state["goals"][servo] - state["positions"][servo]) <= AHEAD / STEP + 2


@KINDS
def test_motors_are_off_while_the_person_leads_and_soon_after_nobody_says_where_the_robot_is(
    kind: str, tmp_path: Path
) -> None:
    with bus_of(kind, COUNTS[kind]) as bus, leader_at(bus, kind, tmp_path, torque=True) as device:
        device.open()
        first = device.read()
        assert first is not None
        robot = np.array(first.hands["right"].joints) + 0.2
        for _ in range(3):
            show(device, robot)
            show(device, robot)
            assert with_torque(bus) == joints_of(bus)
            show(device, robot, "engaged")
            assert not with_torque(bus)
        for _ in range(10):  # a machine that pauses makes it as silent as nobody
            show(device, robot, "released")
            if with_torque(bus):
                break
        assert with_torque(bus)
        silent = time.monotonic()
        while time.monotonic() < silent + FRESH + 0.05:
            device.read()
        assert not with_torque(bus)


@KINDS
def test_motors_are_off_at_the_end_and_when_a_servo_does_not_answer(kind: str, tmp_path: Path) -> None:
    with bus_of(kind, COUNTS[kind]) as bus, leader_at(bus, kind, tmp_path, torque=True) as device:
        for is_lost in (True, False):
            device.open()
            first = device.read()
            assert first is not None
            show(device, np.array(first.hands["right"].joints) + 0.2)
            assert with_torque(bus)
            if is_lost:
                bus.tell(mute=[3])
                with pytest.raises(DeviceFault, match="3"):
                    device.read()
            device.close()  # as the feed of a device that is lost does
            bus.tell(mute=[])
            deadline = time.monotonic() + 20
            while with_torque(bus):
                assert time.monotonic() < deadline


PROGRAM = """
    import sys, time
    import numpy as np
    from rcs.teleop.gello import gello
    from rcs.teleop.so101_leader import so101_leader
    make = so101_leader if sys.argv[1] == "feetech" else gello
    device = make(sys.argv[2], torque=True)
    device.open()
    joints = np.array(device.read().hands["right"].joints) + 0.2
    for _ in range(5):
        device.feedback({"joints": joints}, {"operator": {"right": "held"}, "led": {}})
        device.read()
    print("on", flush=True)
    sys.stdin.readline()
    raise SystemExit("an error that nobody catches")
"""


@KINDS
@pytest.mark.parametrize("is_killed", [False, True], ids=["error", "killed"])
def test_a_program_that_ends_leaves_no_motor_on(kind: str, is_killed: bool, tmp_path: Path) -> None:
    with bus_of(kind, COUNTS[kind]) as bus:
        address = bus.path if kind == "feetech" else saved(calibrated(bus.path), tmp_path)
        words = [sys.executable, "-c", textwrap.dedent(PROGRAM), kind, address]
        with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
            assert program.stdout is not None
            assert program.stdout.readline() == b"on\n"
            assert with_torque(bus)
            if is_killed:
                os.kill(program.pid, signal.SIGKILL)
            program.communicate(b"\n", timeout=60)
        if not is_killed:
            assert not with_torque(bus)
        elif kind == "dynamixel":  # servos drop their current; those of Feetech keep their small torque
            time.sleep(0.3)
            with gello(address) as device:
                device.open()
                assert not with_torque(bus)
            assert set(bus.tell()["limits"].values()) == {0}


def test_a_servo_whose_current_cannot_be_bounded_is_refused_and_nothing_is_on(tmp_path: Path) -> None:
    with bus_of("dynamixel", COUNTS["dynamixel"]) as bus, leader_at(bus, "dynamixel", tmp_path, torque=True) as device:
        bus.tell(modeless=True)
        device.open()
        with pytest.raises(DeviceFault, match="leave out the torque"):
            show(device, np.zeros(7))
        assert not with_torque(bus)


@pytest.mark.slow
def test_engaging_needs_no_leap_since_the_leader_has_come_to_the_robot(tmp_path: Path) -> None:
    with (
        bus_of("dynamixel", COUNTS["dynamixel"]) as bus,
        rcs.make("Free", stepping="realtime", max_episode_steps=None, binary_gripper=False) as env,
    ):
        pressed: list[Any] = []
        foot = ScriptedDevice(lambda t: held(None, *pressed), is_waiting=True)
        offsets = tuple(
            (np.array(env.robots["fr3"].arm.home) + 0.4 - np.array([1, -1, 1, 1, 1, 1, 1]) * np.pi).tolist()
        )
        path = saved(calibrated(bus.path, offsets=offsets, near=env.robots["fr3"].arm.home), tmp_path)
        device = gello(path, torque=True)
        operator = Operator(env, device, beside=[foot])
        observation, info = env.reset(seed=0)
        operator.reset(observation, info)

        def until(is_true: Callable[[], bool]) -> None:
            nonlocal observation, info
            end = time.monotonic() + 60
            while not is_true():
                assert time.monotonic() < end, operator.problem
                observation, _, _, _, info = env.step(operator.act(observation, info))

        start = np.array(observation["joints"])
        until(lambda: operator.news.reading is not None and abs(device._joints - start).max() > 0.3)
        until(lambda: abs(device._joints - observation["joints"]).max() < 0.02)
        assert np.abs(observation["joints"] - start).max() < 1e-3
        pressed.append("clutch")
        until(lambda: operator.states["right"] == "engaged")
        until(lambda: not with_torque(bus))
        assert np.abs(observation["joints"] - start).max() < 0.03
        operator.close()


class Turned(Agent):
    """A policy that turns the first joint by 0.15 rad."""

    goal = np.array(FR3.home) + [0.15, *[0.0] * 6]

    def reset(self, observation: Any, info: Any) -> None:
        """Nothing to forget."""

    def act(self, observation: Any, info: Any) -> dict[str, Any]:
        return {"joints": self.goal, "gripper": np.ones(1, np.float32)}


def test_a_leader_follows_a_policy_and_takes_the_robot_over_without_a_leap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcs.teleop.operator.HELD_UP", 10.0)  # on a busy machine
    pressed: list[Any] = []
    home = np.array(FR3.home)
    with (
        bus_of("dynamixel", COUNTS["dynamixel"]) as bus,
        rcs.make("Free", relative="absolute", max_episode_steps=None, binary_gripper=False) as env,
    ):
        foot = ScriptedDevice(lambda t: held(None, *pressed), is_waiting=True)
        at_home: dict[str, Any] = {
            "signs": (1,) * 7,
            "offsets": tuple((home - 2048 * STEP).tolist()),
            "near": tuple(home.tolist()),
        }
        device = gello(saved(calibrated(bus.path, **at_home), tmp_path), torque=True)
        foot.valid_for = device.valid_for = 2.0  # on a busy machine
        operator = Operator(env, device, beside=[foot], has_thread=False)
        agent = Takeover(env, Turned(), operator)
        observation, info = env.reset(seed=0)
        agent.reset(observation, info)

        def until(is_true: Callable[[], bool]) -> None:
            nonlocal observation, info
            end = time.monotonic() + 60
            while not is_true():
                assert time.monotonic() < end, (agent.actor, operator.problem)
                observation, _, _, _, info = env.step(agent.act(observation, info))

        until(lambda: np.abs(observation["joints"] - Turned.goal).max() < 5e-3)
        until(lambda: np.abs(device._joints - Turned.goal).max() < 0.01)
        assert with_torque(bus) == joints_of(bus)
        pressed.append("takeover")
        until(lambda: agent.actor == "person")
        pressed.append("clutch")
        until(lambda: operator.states["right"] == "engaged")
        until(lambda: not with_torque(bus))
        assert np.abs(observation["joints"] - Turned.goal).max() < 0.03
        pressed.clear()
        until(lambda: with_torque(bus) == joints_of(bus))
        agent.close()
    assert agent.actor == "person"


def test_the_command_wants_a_leader_and_a_clutch_beside_it() -> None:
    from rcs.cli.teleop import TeleopCommand

    for given in (("keyboard", "pedal"), ("so101_leader:/dev/none",)):
        with pytest.raises(InvalidSetup, match="has to be the clutch"):
            TeleopCommand(input=given, torque=True)._devices()
    leader, _ = TeleopCommand(input=("so101_leader:/dev/none", "keyboard"), torque=True)._devices()
    assert leader.has_clutch
