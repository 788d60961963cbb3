from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, check, edit
from rcs_data.edit import Harmonise, Part
from rcs_data.edit.images import resized
from rcs_data.errors import InvalidSetup
from rcs_data.files.flags import FrameFlag

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


def test_the_clock_of_a_camera_is_renamed_with_it(tmp_path: Path) -> None:
    times = ("time/monotonic", "time/frames/wrist", "time/device/frames/wrist")
    features = (
        Feature(key=RGB, shape=(16, 24, 3), dtype="uint8", encoding="lossless"),
        *(Feature(key=key, shape=(), dtype="float64", unit="s") for key in times),
    )
    info = DatasetInfo(frequency=30.0, features=features, setup={}, instruction="")
    with DatasetWriter.open(tmp_path / "set", info) as writer, writer.episode("a", seed=0) as episode:
        for row in range(3):
            episode.add({RGB: np.full((16, 24, 3), row, np.uint8), **dict.fromkeys(times, 5 + row / 30)})
        clock = episode.finish(None).timing["devices"]["frames/wrist"]["clock"]
    assert clock is not None
    edit.rename_camera(tmp_path / "set", "wrist", "hand")
    after = Dataset.open(tmp_path / "set")
    assert not [f.key for f in after.info.features if "wrist" in f.key]
    assert after["a"].timing["devices"]["frames/hand"]["clock"] == clock


@pytest.mark.parametrize(("name", "to"), [("side", "front"), ("wrist", ""), ("wrist", "a//b")])
def test_a_name_that_cannot_be_is_refused(dataset: Path, name: str, to: str) -> None:
    with pytest.raises(InvalidSetup):
        edit.rename_camera(dataset, name, to)
    assert Dataset.open(dataset).history == ()


def test_half_the_size_is_the_mean_of_four_pixels_and_half_the_focal_length(dataset: Path) -> None:
    before = Dataset.open(dataset)["000000"]
    colour, depth, matrices = before.column(RGB), before.column(DEPTH), before.column(INTRINSICS)
    edit.resize(dataset, (12, 8))
    after = Dataset.open(dataset)["000000"]
    assert check(dataset).is_ok
    means = colour.reshape(13, 8, 2, 12, 2, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(after.column(RGB), means, atol=3)
    np.testing.assert_array_equal(after.column(DEPTH), depth[:, ::2, ::2])
    # A point in the middle of four pixels, here (9.5, 3.5), is the centre of the new one, (4.5, 1.5).
    seen = np.linalg.solve(matrices, np.array([9.5, 3.5, 1.0])[:, None])
    np.testing.assert_allclose((after.column(INTRINSICS) @ seen)[..., 0], np.tile([4.5, 1.5, 1.0], (13, 1)), atol=1e-12)
    assert (np.diff(after.image_numbers([RGB])[RGB]) == 0).sum() == 4  # repeats stay repeats
    assert after.steps([INTRINSICS]).column(INTRINSICS).null_count == 0


@pytest.mark.parametrize("size", [(8, 4), (24, 8), (96, 64), (7, 5)])
def test_depth_is_what_lies_nearest_to_the_centre_of_a_pixel(dataset: Path, size: tuple[int, int]) -> None:
    before = Dataset.open(dataset)["000000"].column(DEPTH)
    edit.resize(dataset, (np.int64(size[0]), np.int64(size[1])))  # pyright: ignore[reportArgumentType]
    after = Dataset.open(dataset)["000000"].column(DEPTH)
    for axis, (new, old) in enumerate(zip(after.shape[1:], before.shape[1:], strict=True), 1):
        centres = (np.arange(new) + 0.5) * old / new - 0.5
        before = before.take(np.abs(centres[:, None] - np.arange(old)).argmin(axis=1), axis=axis)
    np.testing.assert_array_equal(after, before)


def test_only_frames_of_cameras_change_their_size(tmp_path: Path) -> None:
    shapes: dict[str, Any] = {"observation/frames/wrist/rgb": (16, 16, 3), "touch/left": (8, 8)}
    features = (
        *(Feature(key=key, shape=shape, dtype="uint8" if len(shape) == 3 else "uint16",
                  encoding="jpeg" if len(shape) == 3 else "depth") for key, shape in shapes.items()),
        Feature(key="calib/intrinsics", shape=(3, 3), dtype="float64"),
    )  # fmt: skip
    info = DatasetInfo(frequency=10.0, features=features, setup={}, instruction="")
    with DatasetWriter.open(tmp_path / "set", info) as writer, writer.episode("a", seed=0) as episode:
        episode.add({f.key: np.ones(f.shape, f.numpy_dtype) for f in features})
        episode.finish(True)
    edit.resize(tmp_path / "set", (4, 4))
    after = Dataset.open(tmp_path / "set")["a"]
    assert [after.column(key).shape[1:3] for key in shapes] == [(4, 4), (8, 8)]
    np.testing.assert_array_equal(after.column("calib/intrinsics"), np.ones((1, 3, 3)))
    wrong = Feature(key="observation/frames/wrist/intrinsics", shape=(4,), dtype="float64")
    with pytest.raises(InvalidSetup, match=r"is \(4,\); only intrinsics of \(3, 3\)"):
        resized(DatasetInfo(frequency=10.0, features=(*features, wrong), setup={}, instruction=""), (4, 4))


def test_the_same_size_changes_no_bit(dataset: Path) -> None:
    digest = Dataset.open(dataset).digest()
    edit.resize(dataset, (24, 16))
    assert Dataset.open(dataset).digest() == digest


@pytest.mark.parametrize("size", [(0, 5), (5, -1), (20000, 2)])
def test_a_size_that_makes_no_sense_is_refused(dataset: Path, size: tuple[int, int]) -> None:
    with pytest.raises(InvalidSetup, match="must be from 1"):
        edit.resize(dataset, size)


@pytest.mark.parametrize("size", [(12.0, 8), (12,), (1, 2, 3), "88", 8, None])
def test_what_is_no_width_and_height_is_no_size(dataset: Path, size: Any) -> None:
    with pytest.raises(InvalidSetup, match=r"size is .*; it must be width and height"):
        edit.resize(dataset, size)


def test_intrinsics_of_another_shape_can_stay_or_be_left_out(tmp_path: Path) -> None:
    features = (
        Feature(key=RGB, shape=(16, 24, 3), dtype="uint8", encoding="lossless"),
        Feature(key=INTRINSICS, shape=(4,), dtype="float64"),
    )
    info = DatasetInfo(frequency=30.0, features=features, setup={}, instruction="")
    with DatasetWriter.open(tmp_path / "set", info) as writer, writer.episode("a", seed=0) as episode:
        episode.add({f.key: np.ones(f.shape, f.numpy_dtype) for f in features})
        episode.finish(None)
    digest = Dataset.open(tmp_path / "set").digest()
    edit.resize(tmp_path / "set", (24, 16))
    assert Dataset.open(tmp_path / "set").digest() == digest
    how = Harmonise(size=(12, 8), drop=(INTRINSICS,))
    mixed = edit.mix([Part(path=tmp_path / "set")], tmp_path / "mix", mapping=how)
    assert mixed["a"].column(RGB).shape == (1, 8, 12, 3)


def test_intrinsics_follow_the_frames_that_a_mix_keeps(tmp_path: Path, dataset: Path) -> None:
    mixed = edit.mix([Part(path=dataset)], tmp_path / "mix", mapping=Harmonise(size=(12, 8), drop=(RGB,)))
    edit.resize(dataset, (12, 8))
    for scaled, mapped in zip(Dataset.open(dataset), mixed, strict=True):
        np.testing.assert_array_equal(mapped.column(INTRINSICS), scaled.column(INTRINSICS))
