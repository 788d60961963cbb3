"""An FR3 through `pylibfranka`, the vendor's own library, in a host, before a virtual robot."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from typing import Any

import numpy as np
import pytest
from moving import stream, wait_until, wave
from virtual_fr3 import TROUBLES, virtual_fr3

import rcs
from rcs.devices import Arm
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware import DeviceAddress, Site
from rcs.hardware.franka import FrankaDriver
from rcs.robots import FR3
from rcs.testing import ArmContract
from rcs.virtual import VirtualProcess

pytestmark = [
    pytest.mark.hardware,
    pytest.mark.skipif(
        importlib.util.find_spec("pylibfranka") is None, reason="needs pylibfranka, the extra of that name"
    ),
]

ADDRESS = f"127.{64 + (os.getpid() >> 8) % 64}.{os.getpid() % 250 + 1}.31"
OPTIONS = {"backend": "pylibfranka", "collision_force": 400.0, "collision_torque": [80.0] * 7}
"""Options with which it does not matter what the virtual robot touches."""


@pytest.fixture(scope="module")
def robot() -> Generator[VirtualProcess]:
    with virtual_fr3(ADDRESS) as process:
        yield process


@pytest.fixture(autouse=True)
def _mended(robot: VirtualProcess) -> Generator[None]:
    robot.tell("clear")
    yield
    robot.tell("clear")


def make_arm(address: str = ADDRESS, **options: Any) -> Arm:
    """An arm in a host, as a site makes it."""
    there = DeviceAddress(driver="franka", address=address, options={**OPTIONS, **options})
    return Site(arms={"fr3": there}).devices({"fr3": (FR3, None)}, {}).arms["fr3"]


@pytest.fixture
def arm(robot: VirtualProcess) -> Generator[Arm]:
    with make_arm() as arm:
        time.sleep(0.05)
        arm.recover()
        yield arm


@pytest.mark.slow
class TestContract(ArmContract):  # without the loss of the link: one that was cut does not answer again
    """The contract of all arms."""

    tolerance = 6e-3  # a spring
    stopping_time = 0.5
    speed_margin = 1.25  # springs pull harder after a delay

    @pytest.fixture(autouse=True)
    def _robot(self, robot: VirtualProcess) -> None:
        self.robot = robot
        robot.tell("clear")
        with make_arm() as arm:
            time.sleep(0.05)
            arm.recover()

    def make_device(self) -> Arm:
        return make_arm()

    def provoke_fault(self, device: Arm) -> None:
        self.robot.tell("reflex")
        wait_until(lambda: device.fault)


def test_an_arm_follows_and_comes_to_rest_where_it_is_led(arm: Arm) -> None:
    targets = wave(arm)
    measured = stream(arm, targets)
    assert arm.fault == ""
    assert np.abs(measured[3:] - targets[:-3]).max() < 0.05  # behind by a period and the springs' lag
    arm.command_joints(targets[-1])
    wait_until(arm.has_arrived)
    assert arm.state().joints == pytest.approx(targets[-1], abs=6e-3)


@pytest.mark.parametrize(("words", "told"), TROUBLES)
def test_what_goes_wrong_is_told_in_words_at_once_and_recover_moves_nothing(
    robot: VirtualProcess, arm: Arm, words: tuple[Any, ...], told: str
) -> None:
    targets = wave(arm)
    stream(arm, targets[:10])
    robot.tell(*words)
    began = time.monotonic()
    with contextlib.suppress(DeviceFault):
        while not arm.fault and time.monotonic() < began + 3.0:
            arm.state()
            time.sleep(0.002)
    taken = time.monotonic() - began
    if words[0] in ("freeze", "cut"):  # the library keeps the interpreter, so that its host is killed
        told = r"host.*hangs.*killed"
    assert re.search(told, arm.fault), arm.fault
    assert taken < 1.0  # 0.1 s, or 0.3 s where the controller hangs, on a machine that is not busy
    with pytest.raises(DeviceFault):
        arm.command_joints(targets[10])
    time.sleep(1.5 if words[0] in ("freeze", "cut") else 0.5)
    robot.tell("clear")
    arm.recover()  # a new host finds the robot in the reflex that the end of the old one led to
    assert arm.fault == ""
    before = arm.state().joints
    time.sleep(0.3)
    assert arm.state().joints == pytest.approx(before, abs=2e-3)
    arm.command_joints(arm.state().joints)


def test_a_guided_arm_is_free_and_then_held_where_it_is(arm: Arm) -> None:
    stream(arm, wave(arm)[:5])
    arm.hold()
    wait_until(arm.has_arrived)
    arm.guide(True)
    time.sleep(0.3)
    assert arm.is_guided and not arm.fault
    place = arm.state().joints
    arm.guide(False)
    arm.command_joints(arm.state().joints)
    time.sleep(0.3)
    assert arm.fault == ""
    assert arm.state().joints == pytest.approx(place, abs=0.02)


def test_an_arm_whose_program_is_killed_brakes(robot: VirtualProcess) -> None:
    program = (
        "import time, numpy as np, rcs\n"
        f"there = {{'driver': 'franka', 'address': {ADDRESS!r}, 'options': {OPTIONS!r}}}\n"
        "with rcs.make('Free', robot='fr3', hardware={'fr3': there, 'fr3/gripper': 'fake'}) as env:\n"
        "    env.reset()\n"
        "    for step in range(1000):\n"
        "        env.step({'joints': 0.01 * np.cos(step / 10) * np.eye(7)[0], 'gripper': [1.0]})\n"
        "        print('moving', flush=True)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for _ in range(15):
            assert process.stdout.readline() == "moving\n"
        process.send_signal(signal.SIGKILL)
    time.sleep(0.5)
    with make_arm() as arm:
        before = arm.state().joints
        time.sleep(0.2)
        assert arm.state().joints == pytest.approx(before, abs=1e-3)


def test_arm_and_hand_work_side_by_side_by_both_libraries(robot: VirtualProcess) -> None:
    pytest.importorskip("franky")
    there = DeviceAddress(driver="franka", address=ADDRESS, options=OPTIONS)
    with rcs.make("Free", robot="fr3", hardware={"fr3": there, "fr3/gripper": f"franka:{ADDRESS}"}) as env:
        first, _ = env.reset()
        for _ in range(20):
            seen, _, _, truncated, info = env.step({"joints": np.eye(7)[0] * 0.005, "gripper": np.zeros(1, np.float32)})
            assert not truncated, info
        assert seen["joints"][0] - first["joints"][0] == pytest.approx(0.1, abs=0.04)
        assert seen["gripper"] < first["gripper"]


def test_another_version_of_the_protocol_is_refused_with_both(robot: VirtualProcess) -> None:
    robot.tell("version", 9)
    with pytest.raises(DeviceFault, match=r"server version: 9, library version: 10.*Install"):
        make_arm().open()


def test_an_address_where_nobody_is_is_told_with_what_to_look_at() -> None:
    began = time.monotonic()
    with pytest.raises(DeviceFault, match=r"127\.0\.52\.97.*refused.*cable.*FCI.*other program"):
        make_arm("127.0.52.97").open()
    assert time.monotonic() - began < 3.0


def test_what_this_backend_cannot_do_is_refused() -> None:
    for options, match in (
        ({"backend": "libfranka"}, "valid: 'franky', 'pylibfranka'"),
        (
            {"backend": "pylibfranka", "compliance": rcs.Compliance(tcp=(1000, 60))},
            "TCP compliance needs the backend",
        ),
    ):
        with pytest.raises(InvalidSetup, match=match):
            FrankaDriver().arm("192.0.2.1", FR3, options)
