"""An image read alone is the image that comes when all are read in order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, FrameAccess
from rcs_data import frame_access as module
from rcs_data.compact import _GROUP_OF_IMAGES
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.frame_access import FrameIndex

RGB, LOSSLESS, DEPTH = (f"observation/frames/wrist/{kind}" for kind in ("rgb", "exact", "depth"))
KEYS = (RGB, LOSSLESS, DEPTH)


def make(path: Path, length: int, held: tuple[int, ...] = ()) -> Dataset:
    """A dataset of two episodes with noisy images; the rows in `held` have no new one."""
    features = (
        Feature(key="observation/joints", shape=(2,), dtype="float64"),
        Feature(key=RGB, shape=(16, 24, 3), dtype="uint8", encoding="jpeg"),
        Feature(key=LOSSLESS, shape=(6, 8, 3), dtype="uint8", encoding="lossless"),
        Feature(key=DEPTH, shape=(6, 8), dtype="uint16", encoding="depth"),
    )
    info = DatasetInfo(frequency=30.0, features=features, setup={}, instruction="move")
    rng = np.random.default_rng(0)
    with DatasetWriter.open(path, info) as writer:
        for seed in range(2):
            with writer.episode(f"{seed:06d}", seed=seed) as episode:
                for row in range(length):
                    values: dict[str, object] = {"observation/joints": rng.normal(size=2)}
                    for feature in features[1:]:
                        top = int(np.iinfo(feature.numpy_dtype).max) + 1
                        image = rng.integers(0, top, feature.shape, feature.numpy_dtype)
                        values[feature.key] = None if row in held else image
                    episode.add(values)
                episode.finish(True)
    return Dataset.open(path)


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("held", [(), (0, 1, 5, 6, 9)])
def test_any_order_gives_what_reading_in_order_gives(tmp_path: Path, key: str, held: tuple[int, ...]) -> None:
    found = make(tmp_path / "dataset", 10, held)
    access = FrameAccess()
    order = np.random.default_rng(0).permutation(20).tolist()
    for number in order:
        episode, row = found.episodes[number // 10], number % 10
        np.testing.assert_array_equal(access.frame(episode, key, row), episode.column(key)[row])
    rows = [3, 3, 0, 9, 5, 4]
    encoded = list(found.episodes[0].encoded_frames(key))
    assert access.encoded(found.episodes[0], key, rows) == [encoded[row] for row in rows]


@pytest.mark.parametrize("key", KEYS)
def test_images_are_found_in_every_row_group(tmp_path: Path, key: str) -> None:
    found = make(tmp_path / "dataset", _GROUP_OF_IMAGES + 20, held=(0, 3, _GROUP_OF_IMAGES, _GROUP_OF_IMAGES + 1))
    episode = found.episodes[1]
    index = FrameIndex.of(episode, key)
    assert len(index.loose) == 1  # black, before the first one; all others are in the file
    assert index.places[_GROUP_OF_IMAGES].tolist() == index.places[_GROUP_OF_IMAGES - 1].tolist()
    assert index.read(range(episode.length)) == list(episode.encoded_frames(key))


def test_equal_images_are_one_image(tmp_path: Path) -> None:
    episode = make(tmp_path / "dataset", 8, held=(4, 5)).episodes[0]
    images = FrameIndex.of(episode, RGB).read([3, 4, 5, 6])
    assert images[0] is images[1]
    assert images[1] is images[2]
    assert images[2] is not images[3]


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_files_of_other_writers_are_read_too(tmp_path: Path, compression: str) -> None:
    found = make(tmp_path / "dataset", 12)
    episode = found.episodes[0]
    expected = {key: list(episode.encoded_frames(key)) for key in KEYS}
    path = episode.path / "steps.parquet"
    table = pq.ParquetFile(path).read()
    options = {"use_dictionary": compression == "zstd", "data_page_version": "2.0", "row_group_size": 5}
    pq.write_table(table, path, compression=compression, data_page_size=300, **options)
    for key in KEYS:
        assert FrameIndex.of(episode, key).read(range(12)) == expected[key]


def test_it_looks_no_further_than_it_has_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Not found is not wrong, so it would not be noticed if all images were kept in memory.
    episode = make(tmp_path / "dataset", 300).episodes[0]
    monkeypatch.setattr(module, "_SEARCHED", 256)
    assert not FrameIndex.of(episode, RGB).loose


def test_places_beyond_the_budget_are_found_again(tmp_path: Path) -> None:
    found = make(tmp_path / "dataset", 5)
    access = FrameAccess(cache_bytes=0)
    for row in (0, 4):
        for episode in found.episodes:
            np.testing.assert_array_equal(access.frame(episode, RGB, row), episode.column(RGB)[row])
    assert len(access._indexes) == 1


def test_what_is_not_there_is_refused(tmp_path: Path) -> None:
    episode = make(tmp_path / "dataset", 5).episodes[0]
    access = FrameAccess()
    for row in (-1, 5):
        with pytest.raises(InvalidSetup, match=f"no row {row}; valid are 0 to 4"):
            access.frame(episode, RGB, row)
    with pytest.raises(InvalidSetup, match="not an image"):
        access.encoded(episode, "observation/joints", [0])


def test_damage_is_noticed_before_and_after_the_places_are_known(tmp_path: Path) -> None:
    found = make(tmp_path / "dataset", 5)
    before, after = found.episodes
    access = FrameAccess()
    access.frame(after, RGB, 0)
    path = after.path / "steps.parquet"
    data = bytearray(path.read_bytes())
    start, size = FrameIndex.of(after, RGB).places[4].tolist()
    data[start : start + 2] = b"\0\0"
    path.write_bytes(data)
    with pytest.raises(CorruptEpisode, match=rf"steps\.parquet, '{RGB}', row 4: .* not a whole JPEG"):
        access.frame(after, RGB, 4)
    np.testing.assert_array_equal(access.frame(after, RGB, 3).shape, (16, 24, 3))
    path.write_bytes(data[: start + size - 1])
    with pytest.raises(CorruptEpisode, match="is truncated before the image of row 4"):
        access.frame(after, RGB, 4)
    path.unlink()
    with pytest.raises(CorruptEpisode, match="No such file"):
        access.frame(after, RGB, 4)
    path = before.path / "steps.parquet"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(CorruptEpisode, match="Cannot read"):
        access.frame(before, RGB, 0)
