"""Findings of an examination about the machine's files in `/dev`, and the answers to its packets that count."""

from __future__ import annotations

import os
import socket
import struct
from pathlib import Path
from types import SimpleNamespace

import pytest

from rcs.hardware import machine
from rcs.hardware.usb import UsbDevice


def test_a_serial_port_by_its_number_is_a_warning_with_the_name_to_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "by-id").mkdir()
    link = tmp_path / "by-id/usb-A2"
    link.symlink_to("../../ttyACM0")
    usable = {"path": SimpleNamespace(exists=lambda path: True), "access": lambda path, mode: True}
    monkeypatch.setattr(machine, "os", SimpleNamespace(**{**vars(os), **usable}))
    monkeypatch.setattr("rcs.hardware.plugged_in.LINKS", tmp_path)
    board = UsbDevice(path="1-2", serial="A2", nodes=("ttyACM0",))
    monkeypatch.setattr("rcs.hardware.plugged_in.usb_devices", lambda: [board])
    for path, name in (("/dev/ttyACM0", str(link)), ("/dev/ttyUSB3", "its serial number or place")):
        (found,) = machine.examine_file("so101", path)
        assert (found.part, found.status) == ("so101", "warning")
        assert path in found.message and f"write {name} in its stead" in found.remedy
    for path in ("/dev/pts/3", "/dev/serial/by-id/usb-A2", "/dev/ttyS0"):
        assert machine.examine_file("so101", path) == []


class RawSocket:
    """A raw socket, which gets answers to the packets of this program or of another one."""

    type = socket.SOCK_RAW

    def __init__(self, program: int) -> None:
        self._program = program
        self._here, self._there = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.recv, self.fileno, self.setblocking = self._here.recv, self._here.fileno, self._here.setblocking

    def sendto(self, packet: bytes, address: object) -> None:
        *_, number = struct.unpack(">BBHHH", packet)
        header = bytes([0x45]) + bytes(19)
        self._there.send(header + struct.pack(">BBHHH", 0, 0, 0, self._program & 0xFFFF, number))

    def __enter__(self) -> RawSocket:
        return self

    def __exit__(self, *_: object) -> None:
        self._here.close()
        self._there.close()


@pytest.mark.parametrize(("other", "answers"), [(0, 3), (1, 0)])
def test_the_answer_to_another_program_is_none(monkeypatch: pytest.MonkeyPatch, other: int, answers: int) -> None:
    monkeypatch.setattr(machine, "LONGEST_ANSWER", 0.5)
    monkeypatch.setattr(machine, "_echo_socket", lambda: RawSocket(os.getpid() + other))
    assert len(machine.ping("192.0.2.1", 3, 1000.0)) == answers
