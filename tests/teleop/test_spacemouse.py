"""The SpaceMouse: its reports, and its way through files of the kernel."""

from __future__ import annotations

import os
import struct
import threading
from pathlib import Path

import numpy as np
import pytest

from rcs.errors import DeviceFault
from rcs.teleop.spacemouse import SPEED, TURN_SPEED, KnobReports, SpaceMouse

DEVICE = "rcs.teleop.spacemouse:SpaceMouse"


def described(number: int = 0, vendor: str = "256F", descriptor: str = "05010908A101") -> str:
    """Return umockdev's description of a knob: a HID device with its raw file below."""
    base = f"/devices/usb{number}/0003:{vendor}:C635.000{number + 1}"
    return f"""P: {base}
E: SUBSYSTEM=hid
E: HID_ID=0003:0000{vendor}:0000C635
E: HID_NAME=3Dconnexion SpaceMouse Compact
H: report_descriptor={descriptor}

P: {base}/hidraw/hidraw{number}
N: hidraw{number}
E: DEVNAME=/dev/hidraw{number}
E: SUBSYSTEM=hidraw
L: device=../../../0003:{vendor}:C635.000{number + 1}

"""


def axes(number: int, *counts: int) -> bytes:
    return struct.pack(f"<B{len(counts)}h", number, *counts)


def twist_of(*reports: bytes) -> np.ndarray:
    knob = KnobReports()
    for report in reports:
        knob.feed(report)
    return knob.twist


def test_the_knobs_axes_become_front_left_and_up() -> None:
    right, to_person, down = (350, 0, 0), (0, 350, 0), (0, 0, 350)
    for first, size, at in ((1, SPEED, 0), (2, TURN_SPEED, 3)):
        assert twist_of(axes(first, *right))[at : at + 3].tolist() == [0, -size, 0]
        assert twist_of(axes(first, *to_person))[at : at + 3].tolist() == [-size, 0, 0]
        assert twist_of(axes(first, *down))[at : at + 3].tolist() == [0, 0, -size]


def test_both_kinds_of_reports_mean_the_same() -> None:
    values = (10, -20, 300, 40, -350, 60)
    assert np.array_equal(twist_of(axes(1, *values)), twist_of(axes(1, *values[:3]), axes(2, *values[3:])))


def test_turns_are_right_handed_about_the_axes_of_the_translations() -> None:
    # The map of the axes is a rotation: a mirror would turn the wrong way.
    moved = np.stack([twist_of(axes(1, *row))[:3] / SPEED for row in 350 * np.eye(3, dtype=int)])
    assert np.linalg.det(moved) == pytest.approx(1.0)


def test_reports_that_make_no_sense_change_nothing_and_are_counted() -> None:
    knob = KnobReports()
    knob.feed(axes(1, 100, 0, 0))
    before = knob.twist
    for report in (b"\x01", axes(1, 1, 2), axes(2, 1, 2, 3, 4), axes(1, 32767, 0, 0), b"\x03", b"\x00" * 7):
        assert not knob.feed(report)
    assert knob.damaged == 6
    assert np.array_equal(knob.twist, before)
    assert not knob.feed(b"")
    assert not knob.feed(b"\x17\x50")  # the battery's: fine, though of no use
    assert knob.damaged == 6


@pytest.mark.extras
def test_it_is_found_and_read_through_the_kernels_files(read_mocked) -> None:
    reports = [axes(1, 175, -350, 0), axes(2, 0, 0, 70), b"\x03\x01\x00", b"\x03\x02\x00"]
    inputs = {"/dev/hidraw0": [(100, report) for report in reports]}
    lines = read_mocked(DEVICE, seconds=1.2, description=described(), inputs=inputs)
    assert lines[0] == {"open": True}
    hands = [line["hands"]["right"] for line in lines[1:] if "hands" in line]
    assert {"buttons": ["clutch", "gripper"], "twist": [0.25, -0.125, 0, 0, 0, -0.2]} in [
        {"buttons": hand["buttons"], "twist": [round(value, 6) for value in hand["twist"]]} for hand in hands
    ]
    assert hands[-1]["buttons"] == ["clutch", "start"]
    assert lines[-1]["counts"] == {"damaged": 0}
    # It is deflected and has gone silent: what it said last is not said again.
    assert [hand["buttons"] for hand in hands].count(["clutch", "start"]) == 1


@pytest.mark.extras
def test_no_knob_and_two_alike_are_refused(read_mocked) -> None:
    (none,) = read_mocked(DEVICE, seconds=1, description=described(descriptor="05010906A101"))
    assert none["error"] == "DeviceFault" and "no SpaceMouse" in none["message"]
    (two,) = read_mocked(DEVICE, seconds=1, description=described(0) + described(1))
    assert "/dev/hidraw0" in two["message"] and "/dev/hidraw1" in two["message"] and "path" in two["message"]


def test_a_deflected_knob_that_goes_silent_is_not_read_again(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "knob")
    with SpaceMouse(str(tmp_path / "knob")) as device:
        device.open()
        with (tmp_path / "knob").open("wb", buffering=0) as knob:
            knob.write(axes(1, 350, 0, 0))
            assert device.read() is not None
            assert device.read() is None
            knob.write(b"\x01\x00")  # damaged: it says nothing of the knob
            assert device.read() is None


def test_at_rest_a_reading_is_new_and_has_no_clutch(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "knob")
    with SpaceMouse(str(tmp_path / "knob")) as device:
        device.open()
        with (tmp_path / "knob").open("wb", buffering=0) as knob:
            knob.write(axes(1, 350, 0, 0))
            assert device.read().hands["right"].buttons == {"clutch"}
            knob.write(axes(1, 0, 0, 0))
            assert device.read().hands["right"].buttons == frozenset()
            first, second = device.read(), device.read()
            assert second.time > first.time
            assert not second.hands["right"].twist.any()


def test_a_knob_that_rests_off_zero_is_not_silent(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "knob")
    with SpaceMouse(str(tmp_path / "knob")) as device:
        device.open()
        with (tmp_path / "knob").open("wb", buffering=0) as knob:
            knob.write(axes(1, 5, 0, -3))
            assert device.read() is not None
            reading = device.read()
            assert reading is not None
            assert not reading.hands["right"].twist.any()  # nor does it go on, with a clutch beside it


def test_a_knob_that_is_unplugged_is_a_fault_and_works_again_once_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "knob")
    device = SpaceMouse(str(tmp_path / "knob"))
    device.open()
    (tmp_path / "knob").open("wb", buffering=0).close()
    with pytest.raises(DeviceFault, match="is gone"):
        device.read()
    device.close()
    device.close()
    with pytest.raises(DeviceFault, match="closed"):
        device.read()
    device.open()
    with (tmp_path / "knob").open("wb", buffering=0) as knob:
        knob.write(axes(2, 0, 0, -350))
        assert device.read().hands["right"].twist[5] == TURN_SPEED
    device.close()


def test_close_ends_a_read_of_another_thread(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "knob")
    device = SpaceMouse(str(tmp_path / "knob"))
    device.open()
    faults: list[str] = []

    def read() -> None:
        try:
            while True:
                device.read()
        except DeviceFault as err:
            faults.append(str(err))

    with (tmp_path / "knob").open("wb"):
        thread = threading.Thread(target=read)
        thread.start()
        device.close()
        thread.join(5)
    assert "closed" in faults[0]


def test_a_file_that_may_not_be_read_names_the_rule(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The superuser, as whom tests may run, may read everything: only the system's answer is replaced.
    def refuse(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(DeviceFault, match=r'KERNEL=="hidraw\*".*TAG\+="uaccess".*udevadm trigger'):
        SpaceMouse("/dev/hidraw0").open()
