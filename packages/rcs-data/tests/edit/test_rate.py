from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rcs_data import Dataset, check, edit
from rcs_data.edit.rate import at_rate, from_rotvec, from_rpy, kept_rows, multiply, normalized, to_rotvec, to_rpy
from rcs_data.errors import InvalidSetup
from rcs_data.files.flags import FrameFlag

if TYPE_CHECKING:
    from conftest import MakeDataset

RGB, INTRINSICS = "observation/frames/wrist/rgb", "observation/frames/wrist/intrinsics"


@given(st.integers(0, 2000), st.floats(1.001, 50))
def test_the_first_and_the_last_row_stay_and_steps_are_as_long_as_asked(length: int, ratio: float) -> None:
    kept = kept_rows(length, ratio)
    assert len(kept) == min(length, len(kept))
    if length:
        assert (kept[0], kept[-1]) == (0, length - 1)
    steps = np.diff(kept)
    assert (steps > 0).all()
    if len(steps) > 1:
        assert (np.abs(steps[:-1] - ratio) <= 1).all()
        assert steps[-1] <= 1.5 * ratio + 1


def test_relative_actions_of_the_new_steps_lead_to_where_the_old_ones_led(dataset: Path) -> None:
    edit.resample(dataset, 5)
    opened = Dataset.open(dataset)
    assert opened.info.frequency == 5
    assert [episode.length for episode in opened.episodes] == [3, 2, 1, 4]
    for episode in opened.episodes:
        joints, actions = episode.column("observation/joints"), episode.column("action/joints")
        np.testing.assert_allclose(np.diff(joints, axis=0), actions[1:], atol=1e-12)
        np.testing.assert_array_equal(episode.column("executed/joints")[1:], joints[1:])
    assert check(dataset).is_ok, str(check(dataset))


def test_of_absolute_actions_the_last_stays(tmp_path: Path, make_dataset: MakeDataset) -> None:
    path = make_dataset(tmp_path / "set", [13], setup={"relative": "absolute"})
    before = Dataset.open(path).episodes[0].column("action/joints")
    edit.resample(path, 10)
    np.testing.assert_array_equal(Dataset.open(path).episodes[0].column("action/joints")[1:], before[3::3])


def test_relative_actions_of_an_unknown_kind_are_refused(dataset: Path) -> None:
    info = Dataset.open(dataset).info
    features = [replace(f, key=f.key.replace("action/joints", "action/action")) for f in info.features]
    info = replace(info, features=tuple(features))
    with pytest.raises(InvalidSetup, match=r"^action/action cannot be resampled"):
        at_rate(info, 5)
    assert at_rate(replace(info, setup={}), 5).frequency == 5


def test_rewards_are_summed_periods_too_and_ends_stay_ends(dataset: Path) -> None:
    before = [e.column("reward")[1:].sum() for e in Dataset.open(dataset).episodes]
    edit.resample(dataset, 7)
    for total, episode in zip(before, Dataset.open(dataset).episodes, strict=True):
        assert np.nansum(episode.column("reward")) == total
        assert episode.column("terminated").tolist() == [False] * (episode.length - 1) + [True]
        times = episode.column("time/monotonic")
        np.testing.assert_allclose(np.diff(times), episode.column("time/period")[1:], atol=1e-9)


def test_a_frame_is_what_was_seen_and_a_repeat_only_where_nothing_new_came(dataset: Path) -> None:
    before = Dataset.open(dataset)["000000"]
    frames = before.column(RGB)
    edit.resample(dataset, 15)
    after = Dataset.open(dataset)["000000"]
    np.testing.assert_array_equal(after.column(RGB), frames[::2])
    # Rows 0, 2, 4, 6, 8, 10, 12; a repeat is in 2, 5, 8, 11: it shows the row before, which is new since the last kept.
    assert not (after.flags("wrist") & FrameFlag.REPEATED).any()
    np.testing.assert_array_equal(after.sim_state()[:, 0], np.arange(0, 13, 2))


@pytest.mark.parametrize("frequency", [30, 31, 0, -5])
def test_only_a_lower_rate_is_possible(dataset: Path, frequency: float) -> None:
    with pytest.raises(InvalidSetup, match="valid is above 0 and below"):
        edit.resample(dataset, frequency)


def test_a_held_value_is_that_of_its_row(dataset: Path) -> None:
    before = [episode.column(INTRINSICS) for episode in Dataset.open(dataset)]
    edit.resample(dataset, 5)
    for matrices, after in zip(before, Dataset.open(dataset), strict=True):
        np.testing.assert_array_equal(after.column(INTRINSICS), matrices[kept_rows(len(matrices), 6)])


@pytest.mark.parametrize("frequency", ["5", None, True, [5]])
def test_what_is_no_number_is_no_rate(dataset: Path, frequency: Any) -> None:
    with pytest.raises(InvalidSetup, match=r"frequency is .*; valid is a number"):
        edit.resample(dataset, frequency)


def same(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(abs(abs(a @ b) - 1) < 1e-12)


def test_there_and_back() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        rotation = normalized(rng.normal(size=4))
        assert same(from_rotvec(to_rotvec(rotation)), rotation)
        assert same(from_rpy(to_rpy(rotation)), rotation)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_at_a_quarter_turn_of_pitch_the_rotation_is_kept(pitch: float) -> None:
    rotation = from_rpy(np.array([0.4, pitch, 0.9]))
    assert to_rpy(rotation)[2] == 0.0
    assert same(from_rpy(to_rpy(rotation)), rotation)


def test_turns_about_one_axis_add_up() -> None:
    axis = normalized(np.array([0.3, -0.2, 0.9]))
    both = multiply(from_rotvec(0.7 * axis), from_rotvec(0.4 * axis))
    np.testing.assert_allclose(to_rotvec(both), 1.1 * axis, atol=1e-12)


def test_no_turn_is_no_rotation() -> None:
    np.testing.assert_array_equal(to_rotvec(from_rotvec(np.zeros(3))), np.zeros(3))
