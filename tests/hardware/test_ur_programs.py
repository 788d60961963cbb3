"""Programs on the controller of a UR: of a second computer, of one that took over since, of one that was killed."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
from moving import lead, wait_for_fault, wait_until

from rcs.devices import Arm
from rcs.hardware.ur import UrDriver
from rcs.hardware.ur_controller import SCRIPT, Dashboard
from rcs.robots import UR5E
from rcs.virtual import VirtualProcess

pytestmark = pytest.mark.hardware
pytest.importorskip("rtde_control", reason="the extra `ur` is not installed")

ADDRESS = f"127.{64 + (os.getpid() >> 8) % 64}.{os.getpid() % 250 + 1}.12"
# Slow enough for a busy machine without real-time priority.
CALM = {"rate": 125, "watchdog": 2}


@pytest.fixture(scope="module", autouse=True)
def _virtual() -> Iterator[None]:
    with VirtualProcess("ur5e", address=ADDRESS):
        yield


@pytest.fixture
def arm() -> Iterator[Arm]:
    """Give an open arm, which is closed in the end."""
    with UrDriver().arm(ADDRESS, UR5E, CALM) as arm:
        yield arm


def answer(question: str) -> str:
    with Dashboard(ADDRESS) as dashboard:
        return dashboard.ask(question)


SECOND = """
import sys, time
from rcs.hardware.ur import UrDriver
from rcs.robots import UR5E
with UrDriver().arm(sys.argv[1], UR5E, {"rate": 125}) as arm:
    arm.command_joints(arm.state().joints)
    while not arm.fault:
        time.sleep(0.01)
    print(arm.fault)
"""


def test_a_second_program_is_refused_and_the_first_goes_on(arm: Arm) -> None:
    arm.command_joints(arm.state().joints)
    wait_until(lambda: answer("running") == "Program running: true")
    second = subprocess.run([sys.executable, "-c", SECOND, ADDRESS], capture_output=True, text=True, check=True)
    assert "a program already runs" in second.stdout
    assert arm.fault == ""
    assert answer("running") == "Program running: true"


OTHER = b"def rtde_control_of_another_computer():\n  sleep(60)\nend\n"


@pytest.mark.parametrize("is_guided", [False, True])
def test_a_program_that_has_taken_over_since_is_not_stopped(arm: Arm, is_guided: bool) -> None:
    lead(arm, arm.state().joints)
    if is_guided:
        arm.guide(True)
    answer("stop")  # as at the pendant
    assert "control script" in wait_for_fault(arm)
    with socket.create_connection((ADDRESS, SCRIPT)) as other:
        other.sendall(OTHER)
        wait_until(lambda: answer("running") == "Program running: true")
        arm.recover()
        arm.command_joints(arm.state().joints)
        assert "a program already runs" in wait_for_fault(arm)
        arm.recover()
        assert answer("running") == "Program running: true"
    answer("stop")


ORPHAN = """
import sys, time
from rcs.hardware.ur import UrDriver
from rcs.robots import UR5E
arm = UrDriver().arm(sys.argv[1], UR5E, {"rate": 125, "watchdog": 5})
arm.open()
arm.command_joints(arm.state().joints + 0.19)
start = arm.state().joints
while abs(arm.state().joints[0] - start[0]) < 0.03 and not arm.fault:
    time.sleep(0.002)
print(arm.fault or "moves", flush=True)
time.sleep(60)
"""


def test_an_arm_whose_program_is_killed_stops_by_itself() -> None:
    program = subprocess.Popen([sys.executable, "-c", ORPHAN, ADDRESS], stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None
    assert program.stdout.readline() == "moves\n"
    program.kill()
    program.wait()
    wait_until(lambda: answer("running") == "Program running: false", 1.0)
    with UrDriver().arm(ADDRESS, UR5E, CALM) as arm:
        time.sleep(0.5)
        before = arm.state().joints
        time.sleep(0.2)
        assert arm.state().joints == pytest.approx(before, abs=1e-3)
