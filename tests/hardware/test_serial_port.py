"""Serial ports: what is said where one cannot be used."""

from __future__ import annotations

import errno
import os
import pty
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.serial_port import claim, group_of, port_at
from rcs.hardware.usb import UsbDevice


@pytest.fixture
def port() -> Generator[str]:
    ends = pty.openpty()
    yield os.ttyname(ends[1])
    for end in ends:
        os.close(end)


def test_a_port_is_locked_until_its_file_is_closed(port: str) -> None:
    file = claim(port, "servo bus")
    with pytest.raises(DeviceFault, match=rf"The servo bus at {port} is in use by process {os.getpid()} \(.*; end it"):
        claim(port, "servo bus")
    os.close(file)
    os.close(claim(port, "servo bus"))


def test_the_program_that_has_a_port_is_named_however_deep_its_python_lies(port: str, tmp_path: Path) -> None:
    python = tmp_path / ("deep" * 20) / "python"
    python.parent.mkdir()
    python.symlink_to(sys.executable)
    code = "import sys; from rcs.hardware.serial_port import claim; claim(sys.argv[1], 'hand'); print(); input()"
    with subprocess.Popen(
        [python, "-c", code, port],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as other:
        assert other.stdout is not None
        other.stdout.readline()
        with pytest.raises(DeviceFault, match=rf"in use by process {other.pid} \(python -c .*serial_port"):
            claim(port, "hand")
        other.communicate("\n")


@pytest.fixture
def board(monkeypatch: pytest.MonkeyPatch) -> UsbDevice:
    """Plug in a board with a serial port, and a camera."""
    board = UsbDevice(path="1-2.3", serial="5735016631", product="USB Single Serial", nodes=("ttyACM0",))
    camera = UsbDevice(path="1-4", serial="A1", nodes=("video0",))
    monkeypatch.setattr("rcs.hardware.serial_port.usb_devices", lambda: [camera, board])
    return board


def test_a_port_is_found_by_serial_number_or_place_and_never_replaced(port: str, board: UsbDevice) -> None:
    assert port_at(board.serial, "hand") == port_at("usb:1-2.3", "hand") == "/dev/ttyACM0"
    assert port_at(port, "hand") == port
    for absent in ("A1", "usb:1-9", "ttyACM0"):
        with pytest.raises(InvalidSetup) as told:
            port_at(absent, "hand")
        assert f"No hand has the serial number or place '{absent}'. Plugged in: {board}." in str(told.value)


def test_a_port_that_is_not_there_is_told_with_those_that_are(tmp_path: Path, board: UsbDevice) -> None:
    with pytest.raises(DeviceFault, match=r"no hand at .*ttyUSB9: No such file.* \(5735016631\) .*, /dev/ttyACM0\."):
        claim(str(tmp_path / "ttyUSB9"), "hand")


def test_a_port_that_may_not_be_used_is_told_with_its_group(port: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    group = Path(port).group()
    monkeypatch.setattr("os.open", refuse)
    with pytest.raises(DeviceFault, match=rf"You may not use the hand at .*usermod -aG {group} \$USER"):
        claim(port, "hand")


@pytest.mark.parametrize(
    ("others", "who"), [(["process 7 (screen)"], r"process 7 \(screen\)"), ([], "another program")]
)
def test_a_port_that_another_program_has_for_itself_is_told_with_that_program(
    port: str, monkeypatch: pytest.MonkeyPatch, others: list[str], who: str
) -> None:
    def refuse(*_: object) -> int:
        raise OSError(errno.EBUSY, "Device or resource busy")

    monkeypatch.setattr("os.open", refuse)
    monkeypatch.setattr("rcs.hardware.serial_port.holders", lambda path: others)
    with pytest.raises(DeviceFault, match=rf"The hand at {port} is in use by {who}; end it first"):
        claim(port, "hand")


def test_a_group_without_a_name_is_its_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(path: Path) -> str:
        raise KeyError("getgrgid(): gid not found: 4711")

    monkeypatch.setattr(Path, "group", unknown)
    assert group_of(str(tmp_path)) == str(tmp_path.stat().st_gid)
