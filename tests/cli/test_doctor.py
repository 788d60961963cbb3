"""`rcs doctor --site` finds what is wrong with a lab, and moves nothing unless it is told to."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from rcs.cli.main import main
from rcs.devices import CameraMode, Frame, GripperState
from rcs.devices.fakes import FakeArm, FakeCamera, FakeGripper
from rcs.envs.cameras import Cameras
from rcs.envs.setup import Setup
from rcs.errors import MissingDependency
from rcs.hardware import FakeDriver
from rcs.hardware.finding import Finding
from rcs.hardware.machine import examine_file, examine_machine, examine_network, host_of
from rcs.hardware.usb import Plug, UsbDevice, find
from rcs.robots.camera import CameraDescription, CameraMount, looking
from rcs.robots.description import ArmDescription, GripperDescription
from rcs.rollout import examine as module

DRIVER = f"{__name__}:LabDriver"


class StillArm(FakeArm):
    def _command_joints(self, joints: Any) -> None:
        LabDriver.commands += 1
        super()._command_joints(joints)


class LabDriver(FakeDriver):
    """Fakes with one thing wrong, and a count of commands."""

    wrong: ClassVar[str] = ""
    commands: ClassVar[int] = 0
    plugs: ClassVar[Mapping[str, Plug]] = {}

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> FakeArm:
        plain = super().arm(address, about, options)
        arm = StillArm(plain.limits, start=np.array(about.home), name="arm")
        if self.wrong == "beyond":
            arm.body.values = arm.body.target = np.array(plain.limits.joint_upper) + 0.1
        if self.wrong == "reflex":
            arm.open()
            arm.trip("reflex: collision")
        return arm

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> FakeGripper:
        class Gripper(FakeGripper):
            def _state(self) -> GripperState:
                if LabDriver.wrong == "volts":
                    raise OSError("the voltage is low")
                return super()._state()

        return Gripper()

    def camera(
        self, address: str, about: CameraDescription, mode: CameraMode, options: Mapping[str, Any]
    ) -> FakeCamera:
        class Camera(FakeCamera):
            def plug(self) -> Plug | None:
                if address == "absent":
                    find("A2", [], "camera")
                return LabDriver.plugs.get(address)

            def _open(self) -> None:
                if LabDriver.wrong == "library":
                    raise MissingDependency("This needs zed: pip install 'robot-control-stack[zed]'")
                if LabDriver.wrong == "permission":
                    raise PermissionError(13, "Permission denied")

            def _read(self) -> Frame:
                if LabDriver.wrong == "hangs":
                    time.sleep(3.0)
                frame = super()._read()
                if LabDriver.wrong == "slow":
                    number = frame.number // 2
                    return Frame(frame.rgb, number=number, device_time=2 * number / mode.fps)
                if LabDriver.wrong == "frozen":
                    return Frame(frame.rgb, number=1, device_time=1.0)
                if LabDriver.wrong == "black":
                    black = np.zeros_like(frame.rgb)
                    return Frame(black, number=frame.number, device_time=frame.device_time)
                return frame

        return Camera(mode)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(LabDriver, "wrong", "")
    monkeypatch.setattr(LabDriver, "commands", 0)
    monkeypatch.setattr(module, "LIMIT", 0.5)
    entry = {"driver": DRIVER, "address": "a"}
    path = tmp_path / "site.json"
    kinds = {"arms": {"fr3": entry}, "grippers": {"fr3": entry}, "cameras": {"side": {**entry, "address": "b"}}}
    path.write_text(json.dumps(kinds))
    return path


def ended(words: list[str]) -> int:
    with pytest.raises(SystemExit) as end:
        main(words)
    return int(end.value.code or 0)


def examined(site: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[int, list[dict[str, str]]]:
    code = ended(["doctor", "--site", str(site), "--seconds", "0.7", "--json", *more])
    return code, json.loads(capsys.readouterr().out)


def test_a_sound_lab_has_no_fault_and_nothing_moves(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, found = examined(site, capsys, "--page", str(site.with_name("page.html")))
    assert code == 0
    assert {one["part"] for one in found if one["status"] == "ok"} >= {"fr3", "fr3/gripper", "side"}
    assert not [one for one in found if one["status"] == "fault"]
    assert LabDriver.commands == 0
    assert "fr3/gripper" in site.with_name("page.html").read_text()


@pytest.mark.parametrize(
    ("wrong", "part", "words", "remedy"),
    [
        ("reflex", "fr3", "reflex", "free the arm"),
        ("volts", "fr3/gripper", "voltage", "power supply"),
        ("library", "side", "zed", "pip install"),
        ("permission", "side", "Permission denied", "usermod"),
        ("slow", "side", "of 30 frames/s", "light"),
        ("frozen", "side", "nothing new", "cable"),
        ("black", "side", "black", "cover"),
        ("hangs", "side", "has not returned", "unplug"),
    ],
)
def test_what_is_wrong_is_found_with_its_remedy_and_nothing_else(
    site: Path, capsys: pytest.CaptureFixture[str], wrong: str, part: str, words: str, remedy: str
) -> None:
    LabDriver.wrong = wrong
    code, found = examined(site, capsys)
    assert code == 1
    faults = [one for one in found if one["status"] == "fault"]
    assert [one["part"] for one in faults] == [part]
    assert words in faults[0]["message"]
    assert remedy in faults[0]["remedy"]
    assert LabDriver.commands == 0


def test_silence_at_the_end_of_the_reading_counts() -> None:
    end = time.monotonic() + 0.5
    with FakeCamera(CameraMode(64, 48, 30.0, False), clock=lambda: min(time.monotonic(), end)) as camera:
        (found,) = module._watch("side", camera, 0.7, 0.12)
    assert found.status == "fault"
    assert "nothing new for" in found.message


def test_joints_out_of_their_range_are_a_warning(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    LabDriver.wrong = "beyond"
    code, found = examined(site, capsys)
    told = next(one for one in found if one["part"] == "fr3")
    assert (code, told["status"]) == (0, "warning")
    assert "out of their range" in told["message"]


def test_a_site_that_names_what_is_not_there_is_a_fault(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = json.loads(site.read_text())
    for change, words in (
        ({"cameras": {"ceiling": content["cameras"]["side"]}}, "wrist"),
        ({"cameras": {"side": {"driver": "webcams", "address": "c"}}}, "webcam"),
        ({"cameras": {"side": {"driver": "fake", "address": "c", "options": {"zoom": 1}}}}, "zoom"),
    ):
        site.write_text(json.dumps({**content, **change}))
        code, found = examined(site, capsys)
        assert code == 1
        assert words in str([one for one in found if one["status"] == "fault"])


def test_a_wrong_entry_is_a_fault_of_its_own_and_all_others_are_examined(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = json.loads(site.read_text())
    entry = content["cameras"]["side"]
    wrong = {
        "arms": {"fr4": entry},
        "grippers": {"fr4": entry},
        "cameras": {"wrist": {**entry, "address": "absent"}, "ceiling": {**entry, "address": "c"}},
        "tactile": {"fr3_middle": entry},
    }
    site.write_text(json.dumps({kind: {**content.get(kind, {}), **more} for kind, more in wrong.items()}))
    code, found = examined(site, capsys, "--robot", "fr3")
    assert code == 1
    faults = {one["part"]: one for one in found if one["status"] == "fault"}
    assert set(faults) == {"fr4", "fr4/gripper", "wrist", "ceiling", "fr3_middle"}
    assert len([one for one in found if one["status"] == "fault"]) == len(faults)
    assert "'A2'" in faults["wrist"]["message"] and "plug it in" in faults["wrist"]["remedy"]
    assert "fr3_left" in faults["fr3_middle"]["message"] and "site file" in faults["fr3_middle"]["remedy"]
    assert {one["part"] for one in found if one["status"] == "ok"} >= {"fr3", "fr3/gripper", "side"}


def test_two_cameras_that_are_one_device_are_told_and_the_first_is_read(
    site: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plug = Plug(device=UsbDevice(path="1-2", serial="A1", bus=1, speed=480.0), needs=1.0)
    monkeypatch.setattr(LabDriver, "plugs", {"b": plug, "c": plug})
    content = json.loads(site.read_text())
    content["cameras"]["wrist"] = {**content["cameras"]["side"], "address": "c"}
    site.write_text(json.dumps(content))
    _, found = examined(site, capsys)
    (fault,) = (one for one in found if one["status"] == "fault")
    assert fault["part"] == "wrist" and "a device of its own" in fault["message"]
    assert "side" in {one["part"] for one in found if one["status"] == "ok"}


def test_a_lab_with_another_hand_or_cameras_of_its_own_is_examined(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = {"driver": "fake", "address": "d"}
    site.write_text(json.dumps({"arms": {"fr3": entry}, "hands": {"fr3": entry}, "cameras": {"ceiling": entry}}))
    code, found = examined(site, capsys)
    assert code == 1
    faults = {one["part"]: one["remedy"] for one in found if one["status"] == "fault"}
    assert set(faults) == {"fr3/hand", "ceiling"} and all("--setup" in one for one in faults.values())
    _, found = examined(site, capsys, "--end-effector", "tilburg_hand")
    assert [one["part"] for one in found if one["status"] == "fault"] == ["ceiling"]
    above = CameraMount(camera="realsense_d435", optical=looking((0.5, 0.0, 1.0), (0.5, 0.1, 0.0)))
    cameras = Cameras(mounts={"ceiling": above}, fps=15)
    setup = Setup(task="Free", robot="fr3", end_effector="tilburg_hand", cameras=cameras)
    file = site.with_name("setup.json")
    file.write_text(json.dumps(setup.to_json()))
    code, found = examined(site, capsys, "--setup", str(file))
    assert code == 0, found
    assert {one["part"] for one in found if one["status"] == "ok"} >= {"fr3", "fr3/hand", "ceiling"}
    assert ended(["doctor", "--site", str(site), "--setup", str(file), "--robot", "fr3"]) != 0
    assert "leave out --robot" in " ".join(capsys.readouterr().err.split())


def test_it_moves_after_a_question_only(
    site: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    answer: Callable[[str | None], None],
) -> None:
    assert ended(["doctor", "--site", str(site), "--seconds", "0.3", "--move"]) != 0, "nobody can be asked"
    assert LabDriver.commands == 0
    capsys.readouterr()
    monkeypatch.setattr("rcs.rollout.exercise.RESTING", 0.1)
    code, found = examined(site, capsys, "--move", "--yes")
    assert code == 0
    assert any("9 clauses of the contract kept; moved by 0.05 rad at 5 %" in one["message"] for one in found)
    assert LabDriver.commands > 0
    LabDriver.commands = 0
    answer("n\n")
    code, found = examined(site, capsys, "--move")
    assert LabDriver.commands == 0
    assert any(one["message"].startswith("nothing moved, because nobody agreed to this: Move every") for one in found)


def test_with_a_fault_nothing_moves_and_that_is_told(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    LabDriver.wrong = "black"
    code, found = examined(site, capsys, "--move", "--yes")
    assert code == 1
    told = [(one["part"], one["status"]) for one in found if one["message"] == "nothing moved: there is a fault"]
    assert told == [("motion", "warning")]
    assert LabDriver.commands == 0


def test_an_input_that_ends_at_the_question_ends_the_command(
    site: Path, capsys: pytest.CaptureFixture[str], answer: Callable[[str | None], None]
) -> None:
    answer("")
    assert ended(["doctor", "--site", str(site), "--seconds", "0.7", "--move"]) == 1
    assert "The input has ended" in " ".join(capsys.readouterr().err.split())
    assert LabDriver.commands == 0


def test_options_of_an_examination_are_refused_without_a_site(capsys: pytest.CaptureFixture[str]) -> None:
    assert ended(["doctor", "--robot", "fr3", "--move", "--json"]) == 1
    assert "--robot, --move, --json has no meaning without --site" in " ".join(capsys.readouterr().err.split())


def test_the_machine_is_described(tmp_path: Path) -> None:
    cpu = tmp_path / "devices/system/cpu/cpu0/cpufreq"
    cpu.mkdir(parents=True)
    (cpu / "scaling_governor").write_text("powersave\n")
    found = examine_machine(tmp_path)
    assert any("powersave" in one.message and "cpupower" in one.remedy for one in found)
    (cpu / "scaling_governor").write_text("performance\n")
    (tmp_path / "kernel").mkdir()
    (tmp_path / "kernel/realtime").write_text("1\n")
    assert not any("governor" in one.message or "PREEMPT_RT" in one.message for one in examine_machine(tmp_path))


def test_files_and_addresses_that_are_not_there_are_faults(tmp_path: Path) -> None:
    assert examine_file("so101", str(tmp_path / "tty"))[0].status == "fault"
    (tmp_path / "tty").touch()
    assert examine_file("so101", str(tmp_path / "tty")) == []
    assert examine_network("", "so101") == []
    (here,) = examine_network("127.0.0.1", "ur", packets=50)
    assert "50 packets at 500 Hz" in here.message or "may not" in here.message


@pytest.mark.parametrize(
    ("address", "driver", "host"),
    [
        ("192.0.2.1", "ur", "192.0.2.1"),
        ("arm.lab", "franka", "arm.lab"),
        ("127.0.0.1:7007", "module:Class", "127.0.0.1"),
        ("http://camera.lab:8080/left?a=b", "webcam", "camera.lab"),
        ("http://192.0.2.7/left", "digit", "192.0.2.7"),
        *((word, "webcam", "") for word in ("0123456789", "D20001", "usb:1-2.3", "", "http://[", "records/a.bag")),
        ("/dev/ttyUSB0", "robotiq", ""),
        ("usb:1-2.3", "robotiq", ""),
    ],
)
def test_the_host_of_an_address_is_known(address: str, driver: str, host: str) -> None:
    assert host_of(address, driver) == host


def test_a_name_without_an_address_is_a_fault_and_that_of_a_host_is_resolved(monkeypatch: pytest.MonkeyPatch) -> None:
    def resolved(name: str) -> str:
        if name != "camera.lab":
            raise socket.gaierror(-2, "Name or service not known")
        return "127.0.0.1"

    monkeypatch.setattr("socket.gethostbyname", resolved)
    (found,) = examine_network("camera.lab", "webcam", packets=5)
    assert found.part == "network camera.lab" and "no address" not in found.message
    (found,) = examine_network("arm.lab", "franka", packets=5)
    assert (found.part, found.status) == ("network arm.lab", "fault")
    assert "Name or service not known" in found.message and "IP address" in found.remedy


def test_a_device_whose_file_has_a_warning_is_examined_all_the_same(
    site: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    warning = Finding(part="fr3", status="warning", message="/dev/ttyUSB0 is a number")
    monkeypatch.setattr(module, "examine_file", lambda part, path: [warning])
    site.write_text(json.dumps({"arms": {"fr3": {"driver": DRIVER, "address": "/dev/ttyUSB0"}}}))
    code, found = examined(site, capsys)
    assert code == 0
    assert {one["status"] for one in found if one["part"] == "fr3"} == {"warning", "ok"}


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "inf"])
def test_a_time_in_which_nothing_can_be_read_is_refused(
    site: Path, seconds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended(["doctor", "--site", str(site), f"--seconds={seconds}"]) == 1
    assert "valid is a finite number, at least 0.5" in " ".join(capsys.readouterr().err.split())


def test_a_page_that_cannot_be_written_is_refused_before_anything_is_examined(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    begin = time.monotonic()
    assert ended(["doctor", "--site", str(site), "--seconds", "30", "--page", str(site.parent)]) == 1
    assert time.monotonic() - begin < 20.0
    assert "is a folder" in " ".join(capsys.readouterr().err.split())
