"""Programs that use a host end, stand still, fork or come second, and `rcs stop`: the devices hold."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from unruly import holds

from rcs.errors import DeviceFault
from rcs.hardware import Site, hosted
from rcs.hardware.hosted import Place
from tests.hardware.hosting import (
    FAR,
    SOON,
    is_running,
    program,
    unruly_arm,
    unruly_gripper,
    wait_for,
)


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


def test_a_host_whose_program_ended_before_it_served_ends() -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        ended.wait()
    words = [sys.executable, "-P", "-m", "rcs.hardware.host", "fake", "orphan", "", str(ended.pid)]
    assert subprocess.run(words, timeout=60.0, check=False).returncode == 0


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
        assert arm.fault == "its host ends"
        wait_for(lambda: len(holds(tmp_path)) > before)


def test_a_host_of_another_version_is_refused() -> None:
    path = Place(driver="fake", address="old").socket
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()

        def greet() -> None:
            with listener.accept()[0] as connection:
                connection.sendall(b"here")  # as before versions were told

        greeting = threading.Thread(target=greet)
        greeting.start()
        with pytest.raises(DeviceFault, match=rf"process {os.getpid()}\) runs another version of the device interf"):
            hosted.call(path)
        greeting.join()
    path.unlink()


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


def test_rcs_stop_asks_all_hosts_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names, together = ["left", "middle", "right"], threading.Barrier(3)
    for name in names:
        (tmp_path / f"{name}.sock").touch()
    monkeypatch.setattr(hosted, "folder", lambda: tmp_path)
    monkeypatch.setattr(hosted, "_stop", lambda _: f"holds {together.wait(2.0)}")
    assert list(hosted.stop_hosts()) == names


def test_rcs_stop_without_hosts_says_so() -> None:
    stop = rcs_command("stop")
    assert "No host" in stop.communicate()[0]
    assert stop.returncode == 0
