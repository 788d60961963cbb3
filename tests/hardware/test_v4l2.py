"""Modes and controls of cameras by the kernel's calls, over a stub of the kernel with the layouts of `videodev2.h`."""

from __future__ import annotations

import errno
import struct
from typing import Any

import pytest

from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware import v4l2

MODES = {b"MJPG": [(640, 480, [(1, 30), (1, 15)]), (1280, 720, [(1001, 30_000)])], b"YUYV": [(640, 480, [(1, 5)])]}
"""Sizes by format, with their periods [s] as fractions."""
EXPOSURE, AUTO_EXPOSURE, GAIN, LINE = 0x009A0902, 0x009A0901, 0x00980913, 0x00980918


class Kernel:
    """A camera: its modes, and least and greatest value of its controls."""

    def __init__(self) -> None:
        self.ranges = {EXPOSURE: (3, 2047), AUTO_EXPOSURE: (0, 3), GAIN: (0, 100), LINE: (0, 2)}
        self.values = dict.fromkeys(self.ranges, 0)
        self.disabled: set[int] = set()
        self.refused: set[tuple[int, int]] = set()
        """Controls with values that they do not take."""
        self.most = 2047
        """The greatest value that is kept."""

    def __call__(self, file: int, call: int, packet: bytearray) -> int:
        assert call >> 16 & 0x3FFF == len(packet), "the call says how long its packet is"
        number = call & 0xFF
        answer = {74: self._size, 75: self._interval, 36: self._query, 27: self._get, 28: self._set}[number]
        try:
            answer(packet)
        except LookupError:
            raise OSError(errno.EINVAL, "Invalid argument") from None
        return 0

    def _size(self, packet: bytearray) -> None:
        index, form = struct.unpack_from("<I4s", packet)
        struct.pack_into("<3I", packet, 8, 1, *MODES[form][index][:2])

    def _interval(self, packet: bytearray) -> None:
        index, form, width, height = struct.unpack_from("<I4s2I", packet)
        (periods,) = (periods for *size, periods in MODES[form] if size == [width, height])
        struct.pack_into("<3I", packet, 16, 1, *periods[index])

    def _query(self, packet: bytearray) -> None:
        (control,) = struct.unpack_from("<I", packet)
        struct.pack_into("<4iI", packet, 40, *self.ranges[control], 1, 0, control in self.disabled)

    def _get(self, packet: bytearray) -> None:
        (control,) = struct.unpack_from("<I", packet)
        struct.pack_into("<i", packet, 4, self.values[control])

    def _set(self, packet: bytearray) -> None:
        control, value = struct.unpack("<Ii", packet)
        if (control, value) in self.refused:
            raise LookupError
        self.values[control] = min(value, self.most)


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    kernel = Kernel()
    monkeypatch.setattr("rcs.hardware.v4l2.fcntl.ioctl", kernel)
    return kernel


def set_controls(**wanted: Any) -> None:
    v4l2.set_controls(0, "webcam A1", wanted)


def test_modes_are_those_of_a_format(kernel: Kernel) -> None:
    found = v4l2.modes(0, "MJPG")
    assert [mode[:2] for mode in found] == [(640, 480), (1280, 720)]
    assert found[0][2] == [15, 30]
    assert found[1][2] == [pytest.approx(29.97, abs=1e-3)]
    assert v4l2.modes(0, "YUYV") == [(640, 480, [5])]
    assert v4l2.modes(0, "H264") == []


def test_controls_are_set_in_the_kernels_units_and_the_others_left_to_the_camera(kernel: Kernel) -> None:
    set_controls(exposure=0.008, gain=7, power_line_frequency=60)
    assert kernel.values == {EXPOSURE: 80, AUTO_EXPOSURE: 1, GAIN: 7, LINE: 2}
    set_controls()
    assert kernel.values[AUTO_EXPOSURE] == 3, "aperture priority"


def test_what_a_control_does_not_take_is_refused_with_what_it_does(kernel: Kernel) -> None:
    kernel.disabled.add(GAIN)
    for wanted, words in (
        ({"exposure": 1.0}, "exposure of webcam A1 is 1.0; valid is 0.0003 to 0.2047"),
        ({"exposure": "long"}, "'long'; valid is a number"),
        ({"exposure": float("nan")}, "nan; valid is a number"),
        ({"power_line_frequency": 55}, "55 Hz; valid is 0 .off., 50 or 60"),
        ({"white_balance": 4000}, "no control 'white_balance'; it has exposure, power_line_frequency"),
        ({"gain": 1}, "no control 'gain'"),
    ):
        with pytest.raises(InvalidSetup, match=words):
            set_controls(**wanted)


def test_a_control_that_keeps_another_value_is_a_fault(kernel: Kernel) -> None:
    kernel.most = 20
    with pytest.raises(DeviceFault, match="keeps gain at 20 when it is set to 64"):
        set_controls(gain=64)


def test_another_power_line_frequency_is_another_value(kernel: Kernel) -> None:
    kernel.most = 1
    with pytest.raises(DeviceFault, match="keeps power_line_frequency at 1 when it is set to 2"):
        set_controls(power_line_frequency=60)


def test_a_camera_without_aperture_priority_chooses_its_exposure_all_the_same(kernel: Kernel) -> None:
    kernel.refused.add((AUTO_EXPOSURE, 3))
    kernel.values[AUTO_EXPOSURE] = 1
    set_controls()
    assert kernel.values[AUTO_EXPOSURE] == 0
    kernel.refused.add((AUTO_EXPOSURE, 0))
    set_controls()
    kernel.refused.add((AUTO_EXPOSURE, 1))
    with pytest.raises(InvalidSetup, match="webcam A1 always chooses its exposure itself; leave the option"):
        set_controls(exposure=0.008)


def test_a_value_that_a_driver_refuses_is_a_fault_that_names_it(kernel: Kernel) -> None:
    kernel.refused.add((GAIN, 7))
    with pytest.raises(DeviceFault, match="does not take gain = 7: Invalid argument"):
        set_controls(gain=7)
