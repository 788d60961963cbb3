"""Modes, controls, resets and times of RealSense cameras, over a fake of the library whose pictures never come."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from rcs.devices import Camera, CameraMode
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.realsense import RESET_AFTER, RULES, RealsenseDriver
from rcs.hardware.usb import UsbDevice
from rcs.robots.cameras import REALSENSE_D435

COLOUR = [("color", 640, 480, 30), ("color", 1280, 720, 30), ("color", 1280, 720, 15)]
DEPTH = [("depth", 640, 480, 30), ("depth", 848, 480, 30), ("depth", 848, 480, 90)]
COUNTS = {"exposure": (1, 10_000), "enable_auto_exposure": (0, 1), "gain": (0, 128), "power_line_frequency": (0, 2)}
"""Controls of an RGB module, which counts exposure in 100 µs."""
MICROSECONDS = {"exposure": (1, 165_000), "enable_auto_exposure": (0, 1), "emitter_enabled": (0, 2)}
"""Controls of a depth sensor."""


class Names:
    """An enumeration of the library, in which each value is its name."""

    def __getattr__(self, name: str) -> str:
        return name


class Sensor:
    """A sensor with its streams, and the least and greatest value of each control."""

    def __init__(
        self, streams: list[tuple[str, int, int, int]], controls: dict[str, tuple[int, int]], *, is_depth: bool
    ) -> None:
        self.controls, self.values, self.clips = controls, dict[str, float](), False
        self.is_depth_sensor = lambda: is_depth
        self.supports = controls.__contains__
        self.get_option = self.values.__getitem__
        self.get_stream_profiles = lambda: [_profile(*stream) for stream in streams]

    def get_option_range(self, option: str) -> Any:
        return SimpleNamespace(min=self.controls[option][0], max=self.controls[option][1], step=1)

    def set_option(self, option: str, value: float) -> None:
        self.values[option] = min(value, 20.0) if self.clips else value


def _profile(kind: str, width: int, height: int, rate: int) -> Any:
    video = SimpleNamespace(width=lambda: width, height=lambda: height, fps=lambda: rate)
    return SimpleNamespace(
        stream_type=lambda: kind,
        format=lambda: {"color": "rgb8", "depth": "z16"}[kind],
        is_video_stream_profile=lambda: True,
        as_video_stream_profile=lambda: video,
    )


class Library:
    """The camera that is plugged in, and what was asked of it."""

    option = stream = format = camera_info = Names()

    def __init__(self, *sensors: Sensor) -> None:
        self.enabled: list[tuple[Any, ...]] = []
        self.resets = 0
        self.is_held = self.is_streaming = False
        about = {"serial_number": "1", "name": "D400", "physical_port": "/sys/devices/usb2/2-1/2-1:1.0/video4linux"}
        self.device = SimpleNamespace(
            query_sensors=lambda: sensors, get_info=about.get, hardware_reset=lambda: setattr(self, "resets", 1)
        )

    def context(self) -> Any:
        return SimpleNamespace(query_devices=lambda: [self.device])

    def config(self) -> Any:
        return SimpleNamespace(
            enable_device=lambda serial: None, enable_stream=lambda *stream: self.enabled.append(stream)
        )

    def pipeline(self) -> Any:
        return SimpleNamespace(start=self._start, stop=lambda: setattr(self, "is_streaming", False))

    def _start(self, config: Any) -> Any:
        if self.is_held:
            raise RuntimeError("the pipeline does not start")
        self.is_streaming = True
        return SimpleNamespace(get_device=lambda: self.device, get_stream=self._get_stream)

    def _get_stream(self, kind: str) -> None:
        raise RuntimeError("no picture comes")


@pytest.fixture
def rgb() -> Sensor:
    return Sensor(COLOUR, dict(COUNTS), is_depth=False)


@pytest.fixture
def stereo() -> Sensor:
    return Sensor(DEPTH, dict(MICROSECONDS), is_depth=True)


@pytest.fixture
def d435(rgb: Sensor, stereo: Sensor, monkeypatch: pytest.MonkeyPatch) -> Library:
    return plugged_in(monkeypatch, stereo, rgb)


def plugged_in(monkeypatch: pytest.MonkeyPatch, *sensors: Sensor) -> Library:
    library = Library(*sensors)
    monkeypatch.setattr("rcs.hardware.realsense._library", lambda: library)
    return library


def camera(*mode: Any, **options: Any) -> Camera:
    return RealsenseDriver().camera("1", REALSENSE_D435, CameraMode(*(mode or (640, 480, 30.0))), options)


def set_up(*mode: Any, **options: Any) -> None:
    """Open a camera, as far as its pictures."""
    with pytest.raises(DeviceFault, match="no picture comes"):
        camera(*mode, **options).open()


def test_exposure_is_told_in_the_unit_of_the_sensor_that_gives_the_colours(
    d435: Library, rgb: Sensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_up(exposure=0.008)
    assert rgb.values["exposure"] == pytest.approx(80)
    both = Sensor(COLOUR + DEPTH, dict(MICROSECONDS), is_depth=True)
    plugged_in(monkeypatch, both)  # as a D405
    set_up(exposure=0.008)
    assert both.values["exposure"] == pytest.approx(8000)
    with pytest.raises(InvalidSetup, match=r"valid is 1e-06 to 0\.165"):
        camera(exposure=0.2).open()


def test_what_a_control_does_not_take_is_refused_with_what_it_does(d435: Library) -> None:
    for options, words in (
        ({"exposure": 2}, "exposure of RealSense 1 is 2; valid is 0.0001 to 1"),
        ({"gain": 129}, "valid is 0 to 128"),
        ({"power_line_frequency": 55}, "55; valid is 0 .off., 50 or 60 Hz"),
        ({"white_balance": 4000}, "'white_balance'; it has exposure, gain, power_line_frequency, emitter"),
    ):
        with pytest.raises(InvalidSetup, match=words):
            camera(**options).open()
        assert not d435.is_streaming


def test_the_controls_of_a_camera_that_another_program_uses_stay(d435: Library, rgb: Sensor) -> None:
    d435.is_held = True
    with pytest.raises(DeviceFault, match="does not start"):
        camera(exposure=0.008).open()
    assert not rgb.values


def test_a_recording_takes_no_controls() -> None:
    for path in ("side.db3", "side.bag"):
        with pytest.raises(InvalidSetup, match=rf"The options \['exposure', 'emitter'\] set a camera; {path} is a rec"):
            RealsenseDriver().camera(
                path, REALSENSE_D435, CameraMode(640, 480, 30.0), {"emitter": True, "exposure": 0.008}
            )


def test_controls_are_set_on_the_colours_and_the_others_left_to_the_camera(
    d435: Library, rgb: Sensor, stereo: Sensor
) -> None:
    set_up(gain=64, power_line_frequency=60, emitter=False)
    assert rgb.values == {"gain": 64, "power_line_frequency": 2, "enable_auto_exposure": 1}
    assert stereo.values == {"emitter_enabled": 0}
    set_up(exposure=0.01)
    assert rgb.values["enable_auto_exposure"] == 0


def test_a_control_that_keeps_another_value_is_a_fault_and_no_failure_of_the_camera(d435: Library, rgb: Sensor) -> None:
    rgb.clips = True
    clipping = camera(gain=64)
    for _ in range(RESET_AFTER):
        with pytest.raises(DeviceFault, match="keeps gain at 20 when it is set to 64"):
            clipping.open()
    assert not d435.resets


def test_depth_has_the_size_of_the_colours_or_else_the_largest_at_their_rate(d435: Library) -> None:
    set_up(640, 480, 30.0, True)
    set_up(1280, 720, 30.0, True)
    set_up(1280, 720, 30.0, False)
    colour = ("color", 1280, 720, "rgb8", 30)
    assert d435.enabled == [
        ("color", 640, 480, "rgb8", 30),
        ("depth", 640, 480, "z16", 30),
        colour,
        ("depth", 848, 480, "z16", 30),
        colour,
    ]


def test_a_mode_that_is_not_offered_is_refused_with_those_that_are(d435: Library) -> None:
    with pytest.raises(InvalidSetup, match="not offer 640x480 at 60 Hz; it has 640x480 at 30, 1280x720 at 15, 1280x"):
        camera(640, 480, 60.0).open()
    with pytest.raises(InvalidSetup, match=r"no depth at 15 Hz; it has \[30, 90\]"):
        camera(1280, 720, 15.0, True).open()


def test_after_failures_in_a_row_the_hardware_is_reset_and_it_is_told(
    d435: Library, caplog: pytest.LogCaptureFixture
) -> None:
    d435.is_held, failing = True, camera()
    for count in range(RESET_AFTER):
        assert not d435.resets, f"not after {count} failures"
        with pytest.raises(DeviceFault, match="does not start"):
            failing.open()
    assert d435.resets
    assert "its hardware is reset: the pipeline does not start" in caplog.text


def test_a_camera_that_may_not_be_used_or_is_in_use_is_told_with_what_helps(
    d435: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    d435.is_held = True
    place = UsbDevice(path="2-1", product="RealSense", nodes=("video-of-a-camera", "hidraw-of-a-camera"))
    monkeypatch.setattr("rcs.hardware.realsense.usb_devices", lambda: [place, UsbDevice(path="2-2", nodes=("video9",))])
    shut = f"you may not use /dev/video-of-a-camera: copy {RULES} to /etc/udev/rules.d"
    with pytest.raises(DeviceFault, match=f"the pipeline does not start; {shut}"):
        camera().open()
    with pytest.raises(InvalidSetup, match=f"'2'. Plugged in: D400 .1.; {shut}"):
        RealsenseDriver().camera("2", REALSENSE_D435, CameraMode(640, 480, 30.0), {}).open()
    monkeypatch.setattr("rcs.hardware.realsense.os.access", lambda file, mode: True)
    monkeypatch.setattr("rcs.hardware.realsense.holders", lambda file: [f"viewer with {file}"])
    with pytest.raises(DeviceFault, match="the pipeline does not start; it is held by viewer with /dev/video-of-a-"):
        camera().open()


def test_an_emitter_that_stays_off_is_a_fault(d435: Library, stereo: Sensor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stereo, "set_option", lambda option, value: stereo.values.update({option: 0.0}))
    with pytest.raises(DeviceFault, match="keeps emitter at 0 when it is set to 1"):
        camera(emitter=True).open()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"exposure": "fast"}, "exposure is 'fast'; valid is a number"),
        ({"gain": None}, "gain is None; valid is a number"),
        ({"exposure": True}, "exposure is True; valid is a number"),
        ({"gain": float("nan")}, "gain is nan; valid is a number"),
        ({"emitter": "off"}, "emitter is 'off'; valid is true or false"),
    ],
)
def test_a_control_that_is_no_number_is_refused_before_opening(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidSetup, match=words):
        camera(**options)


def test_a_picture_after_the_hosts_clock_was_set_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    real, step = time.time, [0.0]
    monkeypatch.setattr("rcs.hardware.realsense.time.time", lambda: real() + step[0])
    rs = SimpleNamespace(timestamp_domain=Names())
    begin, at = time.monotonic(), real()
    frame = SimpleNamespace(get_timestamp=lambda: 1e3 * at, get_frame_timestamp_domain=lambda: "global_time")
    one: Any = camera()
    for _ in range(2):
        taken, _ = one._host_time(rs, frame, time.monotonic())
        assert taken == pytest.approx(begin, abs=0.1)
    step[0] = 1.0
    with pytest.raises(DeviceFault, match=r"this machine's clock was set by 1\.000 s"):
        one._host_time(rs, frame, time.monotonic())
