"""Grippers and cameras written in Python: what they do wrong is found."""

from __future__ import annotations

import gc
import math
import time

import numpy as np
import pytest

from rcs.devices import Camera, CameraMode, Frame, Gripper, GripperState
from rcs.errors import DeviceFault, InvalidSetup


class Pincers(Gripper):
    def __init__(self, opening: float = 0.5, max_width: float = 0.1, max_force: float = 10.0) -> None:
        super().__init__("pincers", max_width, max_force)
        self.opening = opening

    def _state(self) -> GripperState:
        return GripperState(self.opening)

    def _command_opening(self, opening: float, force: float | None) -> None:
        self.opening, self.force = opening, force

    def _has_arrived(self) -> bool:
        return True

    def _hold(self) -> None:
        return


def test_a_gripper_that_measures_nonsense_is_in_fault() -> None:
    gripper = Pincers(opening=math.nan)
    gripper.open()
    with pytest.raises(DeviceFault, match="not finite"):
        gripper.state()


def test_a_gripper_is_told_the_force_only_where_one_is_given() -> None:
    gripper = Pincers()
    with gripper:
        gripper.command_opening(0.1)
        assert gripper.force is None
        gripper.command_opening(0.1, 5.0, valid_for=1.0)
        assert gripper.force == 5.0
        assert math.isnan(gripper.state().force)


@pytest.mark.parametrize("ahead", [1.0, 1.7e9, math.inf])
def test_what_is_measured_in_the_future_is_a_fault(ahead: float) -> None:
    now = time.monotonic()

    class Early(Pincers):
        def _state(self) -> GripperState:
            return GripperState(0.5, time=now + ahead)

    for device in (Early(), Eye(CameraMode(6, 4, 30.0), Frame(RGB, number=0, time=now + ahead))):
        device.open()
        with pytest.raises(DeviceFault, match="ahead of the host's monotonic clock"):
            device.read() if isinstance(device, Eye) else device.state()
        assert device.fault != ""


def test_a_time_that_is_a_little_ahead_is_taken() -> None:
    eye = Eye(CameraMode(6, 4, 30.0), Frame(RGB, number=0, time=time.monotonic() + 0.01))
    with eye:
        eye.read()


def test_a_frame_needs_a_number() -> None:
    with pytest.raises(TypeError, match="number: int"):
        Frame(RGB)  # pyright: ignore[reportCallIssue]


@pytest.mark.parametrize("figures", [{"max_width": 0.0}, {"max_force": -1.0}, {"max_width": math.nan}])
def test_figures_of_a_gripper_must_be_positive(figures: dict[str, float]) -> None:
    with pytest.raises(InvalidSetup, match="must be positive"):
        Pincers(**figures)


class Eye(Camera):
    def __init__(self, mode: CameraMode, frame: Frame) -> None:
        super().__init__("eye", mode)
        self.frame = frame

    def _read(self) -> Frame:
        return self.frame


RGB = np.zeros((4, 6, 3), np.uint8)
DEPTH = np.zeros((4, 6), np.uint16)


@pytest.mark.parametrize(
    ("mode", "frame"),
    [
        (CameraMode(6, 5, 30.0), Frame(RGB, number=0)),
        (CameraMode(6, 4, 30.0), Frame(RGB, DEPTH, number=0)),
        (CameraMode(6, 4, 30.0, True), Frame(RGB, number=0)),
    ],
)
def test_a_frame_of_another_size_than_the_mode_is_a_fault(mode: CameraMode, frame: Frame) -> None:
    camera = Eye(mode, frame)
    camera.open()
    with pytest.raises(DeviceFault, match=r"a frame is 6 x 4 with.*, the camera's mode is"):
        camera.read()
    assert camera.fault != ""


def test_a_frame_whose_depth_has_another_size_than_its_colours_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="of one size"):
        Frame(RGB, DEPTH[1:], number=0)


def test_a_frame_shares_the_arrays_that_it_was_made_of() -> None:
    rgb, depth = np.zeros((4, 6, 3), np.uint8), np.ones((4, 6), np.uint16)
    camera = Eye(CameraMode(6, 4, 30.0, True), Frame(rgb, depth, number=0))
    with camera:
        frame, again = camera.read(), camera.read()
    del camera
    for mine, first, second in ((rgb, frame.rgb, again.rgb), (depth, frame.depth_mm, again.depth_mm)):
        assert np.shares_memory(mine, first)
        assert np.shares_memory(mine, second)
        assert not first.flags.writeable
    view = frame.rgb
    del frame, again, first, second, mine, rgb
    gc.collect()
    assert (view == 0).all()


@pytest.mark.parametrize("mode", [CameraMode(0, 4, 30.0), CameraMode(6, -1, 30.0), CameraMode(6, 4, 0.0)])
def test_a_mode_that_makes_no_sense_is_refused(mode: CameraMode) -> None:
    with pytest.raises(InvalidSetup, match="must be positive"):
        Eye(mode, Frame(RGB, number=0))
