"""An image read alone is the image that comes when all are read in order."""

from __future__ import annotations

import errno
import pickle
import shutil
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, FrameAccess
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.files.frames_file import FramesFile
from rcs_data.read import frame_access
from rcs_data.read.frame_access import ByteCache

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


@pytest.mark.parametrize("held", [(), (0, 1, 32, 33, 90)])
def test_rows_have_an_image_where_it_is_new(tmp_path: Path, held: tuple[int, ...]) -> None:
    episode = make(tmp_path / "dataset", 100, held).episodes[1]
    whole = pa.concat_tables(episode.rows())
    assert whole.num_rows == 100
    for key in KEYS:
        assert [image is None for image in whole.column(key).to_pylist()] == [row in held for row in range(100)]


def test_pieces_of_rows_are_bounded_by_their_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    episode = make(tmp_path / "dataset", 20).episodes[0]
    whole = pa.concat_tables(episode.rows())
    monkeypatch.setattr("rcs_data.read.episode_record._BYTES_IN_A_PIECE", 2000)
    pieces = list(episode.rows())
    assert len(pieces) > 5
    assert pa.concat_tables(pieces).equals(whole)


def test_equal_images_are_one_image(tmp_path: Path) -> None:
    episode = make(tmp_path / "dataset", 8, held=(4, 5)).episodes[0]
    images = list(episode.encoded_frames(RGB))[3:7]
    assert images[0] is images[1]
    assert images[1] is images[2]
    assert images[2] is not images[3]


def test_few_files_of_all_readers_stay_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = make(tmp_path / "dataset", 5)
    opened: Any = lru_cache(1)(frame_access._opened.__wrapped__)
    monkeypatch.setattr(frame_access, "_opened", opened)
    other = FrameAccess()
    monkeypatch.setattr(frame_access, "_INDEX_BYTES", 0)
    access = FrameAccess()
    for row in (0, 4):
        for episode in found.episodes:
            for reader in (access, other):
                np.testing.assert_array_equal(reader.frame(episode, RGB, row), episode.column(RGB)[row])
    assert opened.cache_info().currsize == len(access._numbers) == 1
    copy = pickle.loads(pickle.dumps(access))
    np.testing.assert_array_equal(copy.frame(found.episodes[0], RGB, 1), found.episodes[0].column(RGB)[1])


def test_too_many_open_files_are_no_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    episode = make(tmp_path / "dataset", 5).episodes[0]

    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(DatasetError, match=r"frames\.zip: Too many open files"):
        FramesFile(episode.path / "frames.zip")


def test_what_is_not_there_is_refused(tmp_path: Path) -> None:
    episode = make(tmp_path / "dataset", 5).episodes[0]
    access = FrameAccess()
    for row in (-1, 5):
        with pytest.raises(InvalidSetup, match=f"no row {row}; valid are 0 to 4"):
            access.frame(episode, RGB, row)
    with pytest.raises(InvalidSetup, match="not an image"):
        access.frame(episode, "observation/joints", 0)


def test_a_damaged_image_is_named_by_its_row_and_others_are_read(tmp_path: Path) -> None:
    episode = make(tmp_path / "dataset", 40).episodes[1]
    path = episode.path / "frames.zip"
    image = list(episode.encoded_frames(RGB))[35]
    data = path.read_bytes()
    path.write_bytes(data.replace(image, b"\0\0" + image[2:]))
    with pytest.raises(CorruptEpisode, match=rf"frames\.zip, '{RGB}', row 35: .* not what was written"):
        FrameAccess().frame(episode, RGB, 35)
    with pytest.raises(CorruptEpisode, match="row 35"):
        list(episode.frames(RGB))
    assert FrameAccess().frame(episode, RGB, 34).shape == (16, 24, 3)


@pytest.mark.parametrize("name", ["frames.zip", "steps.parquet"])
def test_a_file_that_is_cut_or_missing_is_named(tmp_path: Path, name: str) -> None:
    episode = make(tmp_path / "dataset", 40).episodes[0]
    path = episode.path / name
    data = path.read_bytes()
    for size in (*range(0, 40, 8), len(data) // 2, len(data) - 100, len(data) - 1):
        path.write_bytes(data[:size])
        for use in (lambda: FrameAccess().frame(episode, RGB, 0), lambda: list(episode.rows())):
            with pytest.raises(CorruptEpisode, match=f"Cannot read .*{name}"):
                use()
    path.unlink()
    with pytest.raises(CorruptEpisode, match=f"Cannot read .*{name}"):
        FrameAccess().frame(episode, RGB, 0)


def test_images_of_another_episode_are_refused(tmp_path: Path) -> None:
    long, short = make(tmp_path / "long", 40).episodes[0], make(tmp_path / "short", 5).episodes[0]
    shutil.copy(short.path / "frames.zip", long.path)
    for row in (5, 39):
        with pytest.raises(CorruptEpisode, match="not the file that was written"):
            FrameAccess().frame(long, RGB, row)


def test_the_files_are_read_without_this_library(tmp_path: Path) -> None:
    episode = make(tmp_path / "dataset", 40, held=(0, 7)).episodes[0]
    with zipfile.ZipFile(episode.path / "frames.zip") as archive:
        assert archive.testzip() is None
        images = [archive.read(entry) for entry in archive.infolist()]
    rows = pq.read_table(episode.path / "steps.parquet")
    for key in KEYS:
        numbers = rows.column(key).to_pylist()
        assert numbers[0] is None
        assert numbers[7] == numbers[6]
        assert [images[number] for number in numbers[1:]] == list(episode.encoded_frames(key))[1:]
    order = [rows.column(key).to_pylist() for key in KEYS]
    new = [number for row in zip(*order, strict=True) for number in row]
    assert list(dict.fromkeys(number for number in new if number is not None)) == list(range(38 * 3))


def test_what_is_held_is_not_made_again() -> None:
    cache: ByteCache[str] = ByteCache(10)
    made: list[str] = []

    def make(name: str, size: int) -> str:
        return cache.get(name, lambda: (made.append(name) or name.upper(), size))

    assert [make("a", 4), make("b", 4), make("a", 4)] == ["A", "B", "A"]
    assert made == ["a", "b"]
    make("c", 4)  # of a and b, b was used before a
    assert (len(cache), cache.nbytes) == (2, 8)
    make("a", 4)
    make("b", 4)
    assert made == ["a", "b", "c", "b"]


def test_the_newest_stays_even_if_it_is_too_large() -> None:
    cache: ByteCache[int] = ByteCache(10)
    cache.get("small", lambda: (1, 5))
    assert cache.get("large", lambda: (2, 100)) == 2
    assert (len(cache), cache.nbytes) == (1, 100)
    assert cache.get("large", lambda: (3, 100)) == 2


def test_a_negative_capacity_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="-1 bytes"):
        ByteCache(-1)
