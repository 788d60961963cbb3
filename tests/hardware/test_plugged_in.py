"""Devices that are plugged in are shown as lines for a site file."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from rcs.hardware import Site
from rcs.hardware.plugged_in import lasting_name, site_lines
from rcs.hardware.usb import UsbDevice


def test_each_device_is_a_line_of_a_site_without_a_number_that_changes(tmp_path: Path) -> None:
    (tmp_path / "by-path").mkdir()
    (tmp_path / "by-path/usb-2.2").symlink_to("../../ttyACM0")
    (tmp_path / "by-id").mkdir()
    (tmp_path / "by-id/usb-nobody").symlink_to("../../ttyACM0")
    (tmp_path / "by-id/usb-FT1").symlink_to("../../ttyUSB1")
    devices = [
        UsbDevice(path="1-2", serial="A1", product="Webcam", bus=1, speed=480, nodes=("video0", "video1")),
        UsbDevice(path="1-3", product="Cheap webcam", bus=1, speed=480, nodes=("video2",)),
        UsbDevice(path="2-1", serial="D20001", product="DIGIT", bus=2, speed=480, nodes=("video3",)),
        UsbDevice(path="2-2", product="USB2.0-Serial", vendor_id="1a86", nodes=("ttyACM0",)),
        UsbDevice(path="2-3", product="Keyboard"),
        UsbDevice(path="2-4", serial="FT1", product="USB Serial", vendor_id="0403", nodes=("ttyUSB1",)),
        UsbDevice(path="2-5", product="USB Serial", vendor_id="1a86", nodes=("ttyUSB0",)),
        UsbDevice(path="4-1", product="Intel(R) RealSense(TM) 435", vendor_id="8086", speed=5000, nodes=("video4",)),
    ]
    lines = site_lines(devices, tmp_path)
    assert len(lines) == 7, "a keyboard is no device of a site"
    entries: list[tuple[str, dict[str, str]]] = []
    for line in lines:
        entry, _, what = line.partition("    ")
        assert what
        ((kind, named),) = json.loads(f"{{{entry}}}").items()
        Site(**{kind: named})
        entries.append((kind, named["NAME"]))
    assert entries[1] == ("cameras", {"driver": "webcam", "address": "usb:1-3"})
    assert entries[2] == ("tactile", {"driver": "digit", "address": "D20001"})
    # A link by serial number is that of any device of its kind where there is no such number.
    assert entries[3] == ("arms", {"driver": "so101", "address": f"{tmp_path}/by-path/usb-2.2"})
    assert entries[4] == ("hands", {"driver": "tilburg", "address": f"{tmp_path}/by-id/usb-FT1"})
    assert entries[5] == ("arms", {"driver": "so101", "address": "usb:2-5"})
    assert "SO101" in lines[3] and "now /dev/ttyACM0" in lines[3] and "GELLO" in lines[4]
    assert '"realsense"' in lines[6] and "5000 Mbit/s" in lines[6]


def test_devices_with_one_serial_number_are_told_apart_by_their_places(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "by-id").mkdir()
    (tmp_path / "by-id/usb-0001").symlink_to("../../ttyUSB1")
    devices = [
        UsbDevice(path="1-2", serial="0001", product="Webcam", nodes=("video0",)),
        UsbDevice(path="1-3", serial="0001", product="Webcam", nodes=("video2",)),
        UsbDevice(path="1-4", serial="0001", product="USB Serial", nodes=("ttyUSB1",)),
        UsbDevice(path="1-5", serial="A2", product="USB Serial", nodes=("ttyUSB2",)),
    ]
    lines = site_lines(devices, tmp_path)
    assert [line.split('"address": "')[1].split('"')[0] for line in lines] == ["usb:1-2", "usb:1-3", "usb:1-4", "A2"]
    monkeypatch.setattr("rcs.hardware.plugged_in.usb_devices", lambda: devices)
    monkeypatch.setattr("rcs.hardware.plugged_in.LINKS", tmp_path)
    names = [lasting_name(f"/dev/ttyUSB{i}") for i in range(3)]
    assert names == ["", "usb:1-4", "A2"]


def test_nothing_is_said_to_be_nothing() -> None:
    assert "Nothing is plugged in" in site_lines([])[0]
    command = [sys.executable, "-m", "rcs", "list", "--devices"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
