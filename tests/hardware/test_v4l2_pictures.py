"""Cameras on USB ports are opened in the mode and format that were asked for, or refused with a remedy."""

from __future__ import annotations

import errno
import os
import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rcs.devices import CameraMode
from rcs.errors import DeviceFault, InvalidSetup, MissingDependency
from rcs.hardware import v4l2
from rcs.hardware.usb import UsbDevice
from rcs.hardware.v4l2_pictures import MOST_WAITING, V4l2Pictures

PLACE = UsbDevice(path="1-2", serial="A1", product="Webcam", speed=480, nodes=("video7",))
MODES = {"MJPG": [(640, 480, [15.0, 30.0])], "YUYV": [(640, 480, [30.0]), (1280, 720, [5.0])]}


class Capture:
    """OpenCV's capture of a camera, which gives what it can in place of what it is asked for."""

    def __init__(self, formats: tuple[str, ...]) -> None:
        self.formats, self.values, self.is_open = formats, dict[str, Any](), True

    def set(self, name: str, value: Any) -> None:
        self.values[name] = value

    def get(self, name: str) -> float:
        if name == "FOURCC" and self.values[name] not in map(_code, self.formats):
            return float(_code(self.formats[0]))
        return float(self.values.get(name, 0.0))

    def isOpened(self) -> bool:  # noqa: N802  OpenCV's name
        return self.is_open

    def release(self) -> None:
        self.is_open = False


def _code(fourcc: str) -> int:
    return int.from_bytes(fourcc.encode(), "little")


@pytest.fixture
def offered(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Modes by format of the one camera that is plugged in, which a test may change."""
    modes = dict(MODES)
    monkeypatch.setattr("rcs.hardware.v4l2_pictures.usb_devices", lambda: [PLACE])
    monkeypatch.setattr("rcs.hardware.v4l2_pictures.os", SimpleNamespace(**{**vars(os), "open": _opened}))
    monkeypatch.setenv("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")  # as `open` sets it, but not for other tests
    monkeypatch.setattr(v4l2, "modes", lambda file, fourcc: modes.get(fourcc, []))
    monkeypatch.setattr(v4l2, "set_controls", lambda file, name, wanted: None)
    return modes


def _opened(path: str, flags: int) -> int:
    assert path == "/dev/video7"
    return os.open(os.devnull, flags)


def capture_of(monkeypatch: pytest.MonkeyPatch, *formats: str) -> Capture:
    capture = Capture(formats)
    names = ("FOURCC", "FRAME_WIDTH", "FRAME_HEIGHT", "FPS", "BUFFERSIZE", "CONVERT_RGB", "POS_MSEC")
    cv2 = SimpleNamespace(
        **{f"CAP_PROP_{name}": name for name in names},
        CAP_V4L2="V4L2",
        VideoCapture=lambda path, kind: capture,
        VideoWriter=SimpleNamespace(fourcc=lambda *letters: _code("".join(letters))),
    )
    monkeypatch.setattr("rcs.hardware.v4l2_pictures.package_of", lambda *_: cv2)
    return capture


def pictures(width: int = 640, height: int = 480, fps: float = 30.0, *, mjpeg: bool = True) -> V4l2Pictures:
    return V4l2Pictures("A1", CameraMode(width, height, fps, False), {}, what="webcam", mjpeg=mjpeg)


def test_a_camera_is_opened_in_the_mode_and_format(offered: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = capture_of(monkeypatch, "YUYV", "MJPG")
    webcam = pictures(fps=15.0)
    webcam.open()
    assert webcam.serial == "A1"
    assert (capture.values["FRAME_WIDTH"], capture.values["FRAME_HEIGHT"], capture.values["FPS"]) == (640, 480, 15)
    webcam.close()
    assert not capture.is_open


def test_a_mode_that_is_not_offered_is_refused_with_those_that_are(
    offered: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture_of(monkeypatch, "MJPG")
    for mode in ((1280, 720, 30.0), (640, 480, 60.0)):
        with pytest.raises(InvalidSetup, match="as MJPG; it has 640x480 at 15, 30 Hz"):
            pictures(*mode).open()
    with pytest.raises(InvalidSetup, match="as YUYV; it has 640x480 at 30 Hz; 1280x720 at 5 Hz"):
        pictures(1280, 720, 30.0, mjpeg=False).open()


def test_another_format_than_the_one_that_is_read_is_refused(
    offered: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    del offered["MJPG"]
    capture = capture_of(monkeypatch, "YUYV")
    with pytest.raises(InvalidSetup, match="640 x 480 at 30 Hz as MJPG; it gives YUYV"):
        pictures().open()
    assert not capture.is_open


def test_a_camera_that_does_not_start_is_a_fault_that_names_its_holder(
    offered: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture_of(monkeypatch, "MJPG").is_open = False
    set_at = list[str]()
    monkeypatch.setattr("rcs.hardware.v4l2_pictures.holders", lambda path: ["process 7 (cheese)"])
    monkeypatch.setattr(v4l2, "set_controls", lambda file, name, wanted: set_at.append(name))
    with pytest.raises(DeviceFault, match=r"does not start in .* It is held by process 7 \(cheese\)"):
        pictures().open()
    assert not set_at, "the exposure stays that of the program that has it"


def test_a_control_that_is_refused_ends_the_stream(offered: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(file: int, name: str, wanted: dict[str, Any]) -> None:
        assert capture.values, "its stream has started"
        raise InvalidSetup(f"{name} has no control 'gain'")

    capture = capture_of(monkeypatch, "MJPG")
    monkeypatch.setattr(v4l2, "set_controls", refuse)
    with pytest.raises(InvalidSetup, match="webcam A1 has no control 'gain'"):
        pictures().open()
    assert not capture.is_open


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EACCES, "Permission denied; add yourself to its group: sudo usermod -aG video"),
        (errno.EBUSY, r"busy; it is held by process 7 \(cheese\)"),
        (errno.ENODEV, "No such device; check its cable"),
    ],
)
def test_why_a_file_cannot_be_opened_decides_on_the_remedy(
    offered: Any, monkeypatch: pytest.MonkeyPatch, number: int, words: str
) -> None:
    def refuse(path: str, flags: int) -> int:
        raise OSError(number, os.strerror(number))

    capture_of(monkeypatch, "MJPG")
    monkeypatch.setattr("rcs.hardware.v4l2_pictures.os.open", refuse)
    monkeypatch.setattr("rcs.hardware.v4l2_pictures.holders", lambda path: ["process 7 (cheese)"])
    with pytest.raises(DeviceFault, match=f"/dev/video7 cannot be opened: .*{words}"):
        pictures().open()


def test_a_size_with_any_rate_is_not_refused(offered: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    offered["MJPG"] = [(640, 480, [])]
    capture_of(monkeypatch, "MJPG")
    pictures().open()
    with pytest.raises(InvalidSetup, match="does not offer 1280x720 at 30 Hz as MJPG; it has 640x480 at any Hz"):
        pictures(1280, 720).open()


def test_a_camera_that_is_faster_than_asked_gives_pictures(offered: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    capture: Any = capture_of(monkeypatch, "MJPG")
    capture.grab, capture.retrieve = lambda: True, lambda: (True, np.zeros((1, 4), np.uint8))
    webcam = pictures(fps=15.0)
    webcam.open()
    first = webcam.newest().number
    assert 0 <= first <= MOST_WAITING
    assert first < webcam.newest().number <= first + MOST_WAITING + 1


def test_another_camera_at_the_same_place_is_refused(offered: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    capture_of(monkeypatch, "MJPG")
    webcam = V4l2Pictures("usb:1-2", CameraMode(640, 480, 30.0, False), {}, what="webcam")
    webcam.open()
    monkeypatch.setattr("rcs.hardware.v4l2_pictures.usb_devices", lambda: [replace(PLACE, serial="B2")])
    with pytest.raises(DeviceFault, match=r"another camera answers at usb:1-2: .*'B2', not 'A1'"):
        webcam.open()


@pytest.mark.parametrize("what", ["webcam", "DIGIT"])
def test_without_opencv_the_extra_of_the_camera_is_named(monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    camera = V4l2Pictures("A1", CameraMode(640, 480, 30.0, False), {}, what=what)
    with pytest.raises(MissingDependency, match=rf"robot-control-stack\[{what.lower()}\]"):
        camera.open()
