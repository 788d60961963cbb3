from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rcs_data import Dataset, check, edit
from rcs_data.errors import InvalidSetup
from rcs_data.flags import FrameFlag

RGB, DEPTH, INTRINSICS = (f"observation/frames/wrist/{leaf}" for leaf in ("rgb", "depth", "intrinsics"))


def test_renaming_a_camera_there_and_back_changes_no_bit(dataset: Path) -> None:
    before = Dataset.open(dataset)
    frames = before.episodes[0].column(RGB)
    edit.rename_camera(dataset, "wrist", "hand/left")
    after = Dataset.open(dataset)
    np.testing.assert_array_equal(after.episodes[0].column("observation/frames/hand/left/rgb"), frames)
    assert set(after.episodes[0].flags("hand/left")) == {0, FrameFlag.REPEATED}
    assert not [f.key for f in after.info.features if "wrist" in f.key]
    assert check(dataset).is_ok
    edit.rename_camera(dataset, "hand/left", "wrist")
    assert Dataset.open(dataset).digest() == before.digest()


@pytest.mark.parametrize(("name", "to"), [("side", "front"), ("wrist", ""), ("wrist", "a//b")])
def test_a_name_that_cannot_be_is_refused(dataset: Path, name: str, to: str) -> None:
    with pytest.raises(InvalidSetup):
        edit.rename_camera(dataset, name, to)
    assert Dataset.open(dataset).head.history == ()


def test_half_the_size_is_the_mean_of_four_pixels_and_half_the_focal_length(dataset: Path) -> None:
    before = Dataset.open(dataset)["000000"]
    colour, depth, matrices = before.column(RGB), before.column(DEPTH), before.column(INTRINSICS)
    edit.resize(dataset, (12, 8))
    after = Dataset.open(dataset)["000000"]
    assert check(dataset).is_ok
    means = colour.reshape(13, 8, 2, 12, 2, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(after.column(RGB), means, atol=3)
    np.testing.assert_array_equal(after.column(DEPTH), depth[:, ::2, ::2])
    np.testing.assert_array_equal(after.column(INTRINSICS), matrices * np.array([[0.5], [0.5], [1]]))
    assert (np.diff(after.image_numbers([RGB])[RGB]) == 0).sum() == 4  # repeats stay repeats
    assert after.steps([INTRINSICS]).column(INTRINSICS).null_count == 10


def test_the_same_size_changes_no_bit(dataset: Path) -> None:
    digest = Dataset.open(dataset).digest()
    edit.resize(dataset, (24, 16))
    assert Dataset.open(dataset).digest() == digest


@pytest.mark.parametrize("size", [(0, 5), (5, -1), (20000, 2)])
def test_a_size_that_makes_no_sense_is_refused(dataset: Path, size: tuple[int, int]) -> None:
    with pytest.raises(InvalidSetup, match="must be from 1"):
        edit.resize(dataset, size)
