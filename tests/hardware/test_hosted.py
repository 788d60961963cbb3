"""Drivers in a process of their own: whatever happens to one side, the devices hold, and the other side says why."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from unruly import UnrulyDriver, drop, holds, keep_interpreter

import rcs
from rcs.devices import Arm, Gripper, Hand
from rcs.errors import DeviceFault, InvalidAction, InvalidSetup, MissingDependency
from rcs.hardware import Site, hosted
from rcs.hardware.hosted import Place
from rcs.robots.fr3.description import FR3
from rcs.robots.franka_hand.description import FRANKA_HAND
from rcs.robots.tilburg_hand.description import TILBURG_HAND
from rcs.testing import ArmContract, GripperContract, HandContract

HOME = np.array(FR3.home)
FAR = HOME + 0.5
SOON = 5.0
"""How long to wait for what takes a tenth of a second on an idle machine [s]."""


def wait_for(what: Callable[[], object]) -> None:
    limit = time.monotonic() + SOON
    while not what():
        assert time.monotonic() < limit, "waited in vain"
        time.sleep(0.002)


def fails(call: Callable[[], object]) -> bool:
    try:
        call()
    except DeviceFault:
        return True
    return False


def made(kind: str, driver: str, address: str, about: Any, **options: Any) -> Any:
    """Make a device as a site does."""
    given = {"driver": driver, "address": address, "options": {"host": True, **options}}
    site = Site(**{f"{kind}s": {"fr3": given}})
    effector = about if kind != "arm" else None
    devices = site.devices({"fr3": (FR3, effector)}, {})
    return (devices.arms if kind == "arm" else devices.effectors)["fr3"]


def unruly_arm(box: Path, address: str = "unruly") -> Any:
    return made("arm", "unruly:UnrulyDriver", address, FR3, box=str(box))


def unruly_gripper(box: Path, address: str = "unruly") -> Any:
    return made("gripper", "unruly:UnrulyDriver", address, FRANKA_HAND, box=str(box))


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

    def make_arm(self) -> Arm:
        return unruly_arm(self.box, self.address)


class TestHostedGripper(UnrulyOnes, GripperContract):
    stopping_time = 0.05

    def make_gripper(self) -> Gripper:
        return unruly_gripper(self.box, self.address)


class TestHostedHand(Staying, HandContract):
    driver = "fake"
    stopping_time = 0.05

    def make_hand(self) -> Hand:
        return made("hand", self.driver, self.address, TILBURG_HAND)


class TestHostedStandIn(Staying, ArmContract):
    driver = "sim"
    tolerance = 5e-3

    def make_arm(self) -> Arm:
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


# --- What goes wrong in the program -----------------------------------------------------------------------------------


def test_a_device_holds_in_time_while_the_program_keeps_the_interpreter(tmp_path: Path) -> None:
    """Not tight, as tests share their machine; benchmarks/hosted.py has the figures."""
    with unruly_arm(tmp_path) as arm:
        before, begin = len(holds(tmp_path)), time.monotonic()
        arm.command_joints(FAR, 0.05)
        keep_interpreter(0.8)
        kept = time.monotonic() - begin
        first = holds(tmp_path)[before] - begin
        assert 0.05 <= first < kept - 0.2
        arm.command_joints(HOME)
        assert arm.fault == ""


PROGRAM = """
    import sys, time, signal
    sys.path[:] = {path!r}
    import os; os.environ["RCS_HOSTS"] = {folder!r}
    from rcs.hardware import Site
    from rcs.robots.fr3.description import FR3
    import numpy as np
    site = Site(arms={{"fr3": {{"driver": "unruly:UnrulyDriver", "address": "unruly", "options": {{"box": {box!r}}}}}}})
    arm = site.devices({{"fr3": (FR3, None)}}, {{}}).arms["fr3"]
    arm.open()
    arm.command_joints(np.array(FR3.home) + 0.5)
    print(arm.host, flush=True)
    {end}
"""


def program(box: Path, end: str) -> tuple[subprocess.Popen[str], int]:
    """Start a program that moves an arm, and return it with the number of its host when the arm is under way."""
    text = textwrap.dedent(PROGRAM)
    text = text.format(path=sys.path, folder=os.environ[hosted.FOLDER], box=str(box), end=end)
    process = subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, int(process.stdout.readline())


def is_running(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_an_arm_holds_when_its_program_is_ended(number: signal.Signals, tmp_path: Path) -> None:
    process, host = program(tmp_path, "time.sleep(60)")
    before = len(holds(tmp_path))
    process.send_signal(number)
    wait_for(lambda: len(holds(tmp_path)) > before)
    process.communicate()
    wait_for(lambda: not is_running(host))


@pytest.mark.parametrize("end", ["pass", "raise ValueError('as if by mistake')", "os._exit(1)", "os.abort()"])
def test_an_arm_holds_when_its_program_ends_by_itself(end: str, tmp_path: Path) -> None:
    process, host = program(tmp_path, end)
    process.communicate()
    wait_for(lambda: holds(tmp_path))
    wait_for(lambda: not is_running(host))


def test_an_arm_holds_when_its_program_stands_still(tmp_path: Path) -> None:
    process, host = program(
        tmp_path, "exec('while True:\\n  time.sleep(0.01)\\n  if arm.fault: print(arm.fault); break')"
    )
    try:
        before = len(holds(tmp_path))
        process.send_signal(signal.SIGSTOP)
        wait_for(lambda: len(holds(tmp_path)) > before)
        assert is_running(host)
        process.send_signal(signal.SIGCONT)
        assert "stands still, as by Ctrl-Z" in process.communicate(timeout=SOON)[0]
    finally:
        process.kill()


def test_a_child_that_was_forked_does_not_keep_the_arm_moving(tmp_path: Path) -> None:
    child = "child = os.fork(); time.sleep(60) if child == 0 else (print(child, flush=True), time.sleep(60))"
    process, host = program(tmp_path, child)
    assert process.stdout is not None
    forked = int(process.stdout.readline())
    try:
        before = len(holds(tmp_path))
        process.kill()
        wait_for(lambda: len(holds(tmp_path)) > before)
        wait_for(lambda: not is_running(host))
    finally:
        os.kill(forked, signal.SIGKILL)
        process.communicate()


# --- Who has a device -------------------------------------------------------------------------------------------------


def test_a_host_ends_with_its_last_device_and_starts_again(tmp_path: Path) -> None:
    arm, gripper = unruly_arm(tmp_path), unruly_gripper(tmp_path)
    assert arm.host == 0
    with arm:
        host = arm.host
        with gripper:
            assert gripper.host == host
        arm.state()
    assert arm.host == 0
    with gripper:
        assert gripper.host != 0  # another one, or the same if it had not ended yet
    wait_for(lambda: not is_running(host))


def test_a_second_program_is_refused_and_told_who_has_the_device(tmp_path: Path) -> None:
    process, _ = program(tmp_path, "time.sleep(60)")
    try:
        for device in (unruly_arm(tmp_path), unruly_gripper(tmp_path)):
            with pytest.raises(DeviceFault, match=rf"unruly is in use by process {process.pid} \(.*python"):
                device.open()
    finally:
        process.kill()
        process.communicate()


def test_a_host_that_stays_serves_the_next_program_after_one_was_killed(tmp_path: Path) -> None:
    with hosted.start_all([Place(driver="unruly:UnrulyDriver", address="unruly")]) as hosts:
        process, host = program(tmp_path, "time.sleep(60)")
        process.kill()
        process.communicate()
        with unruly_arm(tmp_path) as arm:
            assert [arm.host] == [host] == [one.pid for one in hosts.values()]
            arm.command_joints(FAR)


def test_a_second_arm_at_one_address_is_refused(tmp_path: Path) -> None:
    with unruly_arm(tmp_path), pytest.raises(DeviceFault, match=f"in use by process {os.getpid()}"):
        unruly_arm(tmp_path).open()


def test_sigterm_to_a_host_holds_its_devices_and_says_so(tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        arm.command_joints(FAR)
        before = len(holds(tmp_path))
        os.kill(arm.host, signal.SIGTERM)
        wait_for(lambda: arm.fault)
        assert arm.fault == "its host was told to end"
        wait_for(lambda: len(holds(tmp_path)) > before)


# --- Sites, environments, commands ------------------------------------------------------------------------------------


def test_a_driver_says_whether_its_devices_have_a_host_and_a_site_may_say_otherwise() -> None:
    def arm(driver: str, **options: Any) -> Arm:
        site = Site(arms={"fr3": {"driver": driver, "options": options}})
        return site.devices({"fr3": (FR3, None)}, {}).arms["fr3"]

    assert UnrulyDriver.hosted
    assert type(arm("unruly:UnrulyDriver")).__name__ == "HostedArm"
    assert type(arm("unruly:UnrulyDriver", host=False)).__name__ == "UnrulyArm"
    assert type(arm("fake")).__name__ == "FakeArm"
    assert type(arm("fake", host=True)).__name__ == "HostedArm"
    assert type(arm("sim", host=False)).__name__ == "StandInArm"
    with pytest.raises(InvalidSetup, match="'host' is 'yes'; valid is true or false"):
        arm("fake", host="yes")


def test_an_environment_runs_on_devices_with_a_host(tmp_path: Path) -> None:
    given = {"driver": "unruly:UnrulyDriver", "address": "env", "options": {"box": str(tmp_path)}}
    with rcs.make("Free", robot="fr3", hardware={"fr3": given}, relative=False) as env:
        observation, _ = env.reset()
        action = {"joints": observation["joints"] + 0.01, "gripper": np.ones(1, np.float32)}
        for _ in range(5):
            observation, *_ = env.step(action)
        assert np.abs(observation["joints"] - HOME).max() > 1e-3
        drop(tmp_path, "state", "abort")
        for _ in range(100):
            *_, truncated, info = env.step(action)
            if truncated:
                break
        assert "ended with signal 6" in str(info["faults"])


def rcs_command(*words: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen([sys.executable, "-m", "rcs", *words], stdout=subprocess.PIPE, text=True, env=environment)


def test_hosts_of_a_site_run_for_longer_and_rcs_stop_has_all_devices_hold(tmp_path: Path) -> None:
    given = {"driver": "unruly:UnrulyDriver", "address": "longer", "options": {"box": str(tmp_path)}}
    Site(arms={"fr3": given}, grippers={"fr3": given}).write(tmp_path / "site.json")
    host = rcs_command("host", "--site", str(tmp_path / "site.json"))
    assert host.stdout is not None
    said = json.loads(host.stdout.readline())
    assert [one["name"] for one in said["hosts"]] == ["unruly:UnrulyDriver:longer"]
    for _ in range(2):
        with unruly_arm(tmp_path, "longer") as arm, unruly_gripper(tmp_path, "longer") as gripper:
            assert arm.host == gripper.host == said["hosts"][0]["process"]
            arm.command_joints(FAR)
            stop = rcs_command("stop")
            assert "holds" in stop.communicate()[0]
            assert stop.returncode == 0
            wait_for(lambda: arm.fault and gripper.fault)
            assert arm.fault == f"`rcs stop`, process {stop.pid}"
            arm.recover()
            gripper.recover()
    host.terminate()
    host.communicate()
    wait_for(lambda: not is_running(said["hosts"][0]["process"]))


def test_rcs_stop_kills_a_host_that_does_not_answer(tmp_path: Path) -> None:
    with unruly_arm(tmp_path) as arm:
        os.kill(arm.host, signal.SIGSTOP)
        said = hosted.stop_hosts()
        assert any("was killed" in text for text in said.values()) or "killed" in arm.fault
        wait_for(lambda: arm.fault)


def test_rcs_stop_without_hosts_says_so() -> None:
    stop = rcs_command("stop")
    assert "No host" in stop.communicate()[0]
    assert stop.returncode == 0


def test_a_streamed_arm_in_a_host_plans_for_the_rate_of_commands_and_counts_what_it_did_not_do() -> None:
    arm = made("arm", "unruly:ServoDriver", "servo", FR3)
    options: Any = {"robot": "fr3", "end_effector": "none", "relative": "absolute", "frequency": 50.0}
    with rcs.make("Free", hardware={"fr3": arm}, **options) as env:
        env.reset()
        for ahead in (0.0, 0.0, 1.0, -1.0, 1.0):
            *_, info = env.step({"joints": HOME + 0.05 * ahead})
        assert arm.state().mode == "0.0200"
        assert info["clamped"]["fr3"]["acceleration"] > 0
        with pytest.raises(InvalidSetup, match="from one tick"):
            arm.period = 1e-3


def test_an_arm_in_a_host_that_is_not_streamed_counts_nothing(tmp_path: Path) -> None:
    arm = unruly_arm(tmp_path)
    assert not arm.is_streamed
    with pytest.raises(InvalidSetup, match="of a streamed arm"):
        arm.period = 1 / 30
