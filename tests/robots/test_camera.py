"""The modes of cameras: what can be asked for, and at which rates."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.camera import CameraDescription, ResolutionMode, parse_mode
from rcs.robots.cameras import REALSENSE_D405, REALSENSE_D435, REALSENSE_D435I, USB_WEBCAM

CAMERAS = [REALSENSE_D405, REALSENSE_D435, REALSENSE_D435I, USB_WEBCAM]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.name)
def test_every_mode_is_found_by_its_name_and_offers_its_rates_and_no_other(camera: CameraDescription) -> None:
    for mode in camera.modes:
        size = (mode.width, mode.height)
        assert camera.mode(mode.name) is mode
        assert parse_mode(mode.name) == size
        assert camera.frame_rate(size) == max(mode.rates)
        assert [camera.frame_rate(size, rate) for rate in mode.rates] == list(mode.rates)
        for other in {5, 6, 15, 30, 60, 90, 100} - set(mode.rates):
            with pytest.raises(InvalidSetup, match=mode.name):
                camera.frame_rate(size, other)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.name)
def test_modes_have_even_edges_of_a_usual_shape_and_rates_of_one_clock(camera: CameraDescription) -> None:
    for width, height in [(mode.width, mode.height) for mode in camera.modes] + [size[:2] for size in camera.min_depth]:
        assert width % 2 == height % 2 == 0
        assert min(abs(width / height / shape - 1.0) for shape in (4 / 3, 16 / 9)) < 0.01
    assert all(math.gcd(*mode.rates) >= 3 for mode in camera.modes)


@pytest.mark.parametrize("camera", [one for one in CAMERAS if one.has_depth], ids=lambda c: c.name)
def test_the_nearest_depth_has_the_largest_disparity_that_the_vendors_chip_finds(camera: CameraDescription) -> None:
    for width, _, nearest in camera.min_depth:
        focal = width / 2 / math.tan(camera.stereo_fovx / 2)
        assert 95 < focal * camera.stereo_baseline / nearest < 127  # of 126 [px]


def test_an_unknown_mode_is_refused_with_all_that_there_are() -> None:
    with pytest.raises(UnknownName) as caught:
        REALSENSE_D405.mode("848x484")
    for text in ("realsense_d405", "Did you mean '848x480'?", *(mode.name for mode in REALSENSE_D405.modes)):
        assert text in str(caught.value)


def test_a_rate_that_a_size_does_not_have_is_refused_with_those_that_it_has() -> None:
    with pytest.raises(InvalidSetup) as caught:
        REALSENSE_D435.frame_rate((1280, 720), 60)
    for text in ("60 frames/s", "1280 x 720", "6, 15, 30 for that size", "848x480 at 6, 15, 30, 60 Hz"):
        assert text in str(caught.value)


def test_a_size_that_is_cut_out_has_the_rates_of_the_modes_around_it() -> None:
    assert REALSENSE_D405.frame_rate((224, 224)) == 90
    assert REALSENSE_D435.frame_rate((224, 224)) == 60
    # 320 x 240 lacks 15 frames/s, and larger modes have it.
    assert REALSENSE_D435.frame_rate((84, 84), 15.0) == 15
    assert REALSENSE_D405.frame_rate((900, 500)) == 30
    assert REALSENSE_D405.frame_rate((4000, 3000)) == 30


@pytest.mark.parametrize(
    "figures", [(0, 480, (30,)), (640, -1, (30,)), (640, 480, ()), (640, 480, (30, 30)), (1, 1, (0,))]
)
def test_a_mode_that_makes_no_sense_is_refused(figures: tuple[int, int, tuple[int, ...]]) -> None:
    with pytest.raises(InvalidSetup, match="valid"):
        ResolutionMode(*figures)


@pytest.mark.parametrize("name", ["848", "x", "848x", "848*480", "-1x5", "848x480x30", "８x８"])
def test_the_name_of_a_mode_is_width_x_height(name: str) -> None:
    assert parse_mode(name) is None
    with pytest.raises(UnknownName, match="848x480"):
        REALSENSE_D405.mode(name)


def test_a_camera_has_modes_of_different_sizes_and_no_negative_exposure() -> None:
    mode = REALSENSE_D405.modes[0]
    with pytest.raises(InvalidSetup, match="different sizes"):
        replace(REALSENSE_D405, modes=(mode, mode))
    with pytest.raises(InvalidSetup, match="longest_exposure"):
        replace(REALSENSE_D405, longest_exposure=-0.1)
