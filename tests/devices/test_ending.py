"""However a program ends, its open devices hold first. Each program runs in a process of its own."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

BEGIN = """
import os, signal, sys, threading, time
from rcs.devices.fakes import FakeGripper

class Told(FakeGripper):
    def _hold(self):
        os.write(1, b"held\\n")
        super()._hold()

gripper = Told(speed=1e-3)
"""
OPEN = """
gripper.open()
gripper.command_opening(0.0)
os.write(1, b"open\\n")
"""
WAIT = """
time.sleep(60)
"""


def run(program: str) -> tuple[list[str], str, int]:
    """Return what a program wrote, line by line, its errors, and how it ended."""
    done = subprocess.run(
        [sys.executable, "-c", BEGIN + program], capture_output=True, text=True, timeout=60, check=False
    )
    return done.stdout.splitlines(), done.stderr, done.returncode


def run_until_signalled(program: str, number: int) -> tuple[list[str], int]:
    """Send a signal to a program when it has opened its gripper; return what it wrote then, and how it ended."""
    command = [sys.executable, "-c", BEGIN + program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "open\n"
        process.send_signal(number)
        lines = process.stdout.read().splitlines()
    return lines, process.returncode


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_the_program_has_devices_hold_first(number: int) -> None:
    assert run_until_signalled(OPEN + WAIT, number) == (["held"], -number)


def test_a_program_whose_devices_do_not_hold_ends_all_the_same() -> None:
    stuck = "Told._hold = lambda self: (os.write(1, b'stuck\\n'), time.sleep(60))\n"
    assert run_until_signalled(stuck + OPEN + WAIT, signal.SIGTERM) == (["stuck"], -signal.SIGTERM)


@pytest.mark.parametrize("is_before", [True, False])
def test_a_handler_of_the_program_is_kept(is_before: bool) -> None:
    handler = "signal.signal(signal.SIGTERM, lambda *_: (os.write(1, b'mine\\n'), gripper.close(), os._exit(7)))\n"
    program = handler + OPEN + WAIT if is_before else OPEN.replace("os.write", handler + "os.write") + WAIT
    assert run_until_signalled(program, signal.SIGTERM) == (["mine", "held"], 7)


def test_a_signal_that_the_program_ignores_stops_nothing() -> None:
    ignoring = "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
    program = ignoring + OPEN + "time.sleep(0.2)\nprint(repr(gripper.fault), flush=True)\nos._exit(0)\n"
    assert run_until_signalled(program, signal.SIGHUP) == (["''"], 0)


def test_an_exception_that_nobody_handles_has_devices_hold_before_it_is_told() -> None:
    told = "sys.excepthook = lambda *_: os.write(1, gripper.fault.encode() + b'\\n')\n"
    lines, _, code = run(told + OPEN + "raise ValueError('oops')\n")
    assert lines == ["open", "held", "the program ended with ValueError: oops", "held"]
    assert code == 1


def test_an_exception_in_a_thread_has_devices_hold() -> None:
    program = """
def fail():
    raise ValueError("oops")
thread = threading.Thread(target=fail, name="loop")
thread.start()
thread.join()
print(gripper.fault)
os._exit(0)
"""
    lines, errors, _ = run(OPEN + program)
    assert lines == ["open", "held", "the thread 'loop' ended with ValueError: oops"]
    assert "ValueError: oops" in errors


@pytest.mark.parametrize("end", ["", "sys.exit(3)\n", "threading.Thread(target=sys.exit).start()\n"])
def test_a_program_that_ends_without_closing_has_devices_hold(end: str) -> None:
    lines, errors, code = run(OPEN + end)
    assert lines == ["open", "held"]
    assert errors == ""
    assert code == (3 if end.startswith("sys") else 0)


def test_devices_that_are_closed_are_held_once() -> None:
    assert run(OPEN + "gripper.close()\n")[0] == ["open", "held"]


def test_nothing_is_installed_before_a_device_opens() -> None:
    program = """
print(sys.excepthook is sys.__excepthook__, threading.excepthook is threading.__excepthook__, threading.active_count())
print(open("/proc/self/status").read().split("SigCgt:")[1].split()[0])
gripper.open()
print(sys.excepthook is sys.__excepthook__, threading.excepthook is threading.__excepthook__, threading.active_count())
print(open("/proc/self/status").read().split("SigCgt:")[1].split()[0])
gripper.close()
"""
    before, caught, after, caught_then, *_ = run(program)[0]
    assert (before, after) == ("True True 1", "False False 1")
    ours = 1 << (signal.SIGTERM - 1) | 1 << (signal.SIGHUP - 1)
    assert int(caught, 16) & ours == 0
    assert int(caught_then, 16) & ours == ours


def test_a_child_process_ends_as_if_there_were_no_devices() -> None:
    program = """
child = os.fork()
if child == 0:
    time.sleep(60)
os.kill(child, signal.SIGTERM)
status = os.waitpid(child, 0)[1]
print(os.WTERMSIG(status), repr(gripper.fault), flush=True)
child = os.fork()
if child == 0:
    own = Told()
    own.open()
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(60)
status = os.waitpid(child, 0)[1]
print(os.WTERMSIG(status), repr(gripper.fault), flush=True)
child = os.fork()
if child == 0:
    sys.exit(5)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), repr(gripper.fault), flush=True)
"""
    assert run(OPEN + program)[0] == ["open", "15 ''", "held", "15 ''", "5 ''", "held"]
