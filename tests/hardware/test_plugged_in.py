"""What is plugged in is shown as lines for a site file."""

from __future__ import annotations

import json
import subprocess
import sys

from rcs.hardware import Site
from rcs.hardware.plugged_in import site_lines
from rcs.hardware.usb import UsbDevice


def test_each_device_is_a_line_of_a_site() -> None:
    devices = [
        UsbDevice(path="1-2", serial="A1", product="Webcam", bus=1, speed=480, nodes=("video0", "video1")),
        UsbDevice(path="1-3", product="Cheap webcam", bus=1, speed=480, nodes=("video2",)),
        UsbDevice(path="2-1", serial="D20001", product="DIGIT", bus=2, speed=480, nodes=("video3",)),
        UsbDevice(path="2-2", product="USB2.0-Serial", vendor_id="1a86", nodes=("ttyACM0",)),
        UsbDevice(path="2-3", product="Keyboard"),
        UsbDevice(path="4-1", product="Intel(R) RealSense(TM) 435", vendor_id="8086", speed=5000, nodes=("video4",)),
    ]
    lines = site_lines(devices)
    assert len(lines) == 5, "a keyboard is no device of a site"
    site = {}
    for line in lines:
        entry, _, what = line.partition("    ")
        assert what
        site.update(json.loads(f"{{{entry}}}"))
    assert site["tactile"]["NAME"] == {"driver": "digit", "address": "D20001"}
    Site(cameras={"side": json.loads(f"{{{lines[1].partition('    ')[0]}}}")["cameras"]["NAME"]})
    assert "usb:1-3" in lines[1]
    assert "SO101" in lines[3] and "/dev/ttyACM0" in lines[3]
    assert '"realsense"' in lines[4] and "5000 Mbit/s" in lines[4]


def test_nothing_is_said_to_be_nothing() -> None:
    assert "Nothing is plugged in" in site_lines([])[0]
    command = [sys.executable, "-m", "rcs", "list", "--devices"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
