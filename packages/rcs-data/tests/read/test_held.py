"""Values that a row has from the row before: images of a slow camera, matrices that rarely change."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rcs_data import DatasetInfo, DatasetWriter, EpisodeRecord, Feature, check
from rcs_data.files.flags import FrameFlag

RGB, DEPTH, MATRIX = "observation/frames/wrist/rgb", "observation/frames/wrist/depth", "observation/frames/wrist/matrix"
FLAGS = "flags/frames/wrist"
SHAPE = (12, 16, 3)


def info_of(encoding: Any = "lossless") -> DatasetInfo:
    features = (
        Feature(key=RGB, shape=SHAPE, dtype="uint8", encoding=encoding),
        Feature(key=DEPTH, shape=SHAPE[:2], dtype="uint16", encoding="depth"),
        Feature(key=MATRIX, shape=(2, 2), dtype="float64", encoding="held"),
        Feature(key=FLAGS, shape=(), dtype="uint8"),
    )
    return DatasetInfo(frequency=100.0, features=features, setup={}, instruction="")


def record(path: Path, rows: list[dict[str, Any]], info: DatasetInfo | None = None) -> EpisodeRecord:
    with DatasetWriter.open(path, info or info_of()) as writer, writer.episode("a", seed=0) as episode:
        for row in rows:
            episode.add(row)
        return episode.finish(None)


def images(n: int) -> list[NDArray[np.uint8]]:
    return list(np.random.default_rng(n).integers(0, 256, (n, *SHAPE), np.uint8))


def row(rgb: NDArray[np.uint8] | None, matrix: float, flags: int | None = None) -> dict[str, Any]:
    depth = None if rgb is None else rgb[..., 0].astype(np.uint16)
    return {RGB: rgb, DEPTH: depth, MATRIX: np.full((2, 2), matrix, np.float64), FLAGS: flags}


def test_a_row_without_an_image_has_that_of_the_row_before(tmp_path: Path) -> None:
    a, b = images(2)
    episode = record(tmp_path, [row(a, 0), row(None, 0, 1), row(None, 0, 1), row(b, 0), row(None, 0, 1)])
    np.testing.assert_array_equal(episode.column(RGB), [a, a, a, b, b])
    np.testing.assert_array_equal(episode.column(DEPTH), np.array([a, a, a, b, b])[..., 0])


def test_only_new_images_are_stored(tmp_path: Path) -> None:
    a, b = images(2)
    episode = record(tmp_path, [row(a, 0), *[row(None, 0, 1)] * 200, row(b, 0)])
    assert episode.steps([RGB]).column(RGB).to_pylist() == [0, *[0] * 200, 2]
    assert sum(file.stat().st_size for file in episode.path.iterdir()) < 30 * a.nbytes


def test_before_the_first_image_all_is_black(tmp_path: Path) -> None:
    (a,) = images(1)
    episode = record(tmp_path, [row(None, 0), row(a, 0)])
    np.testing.assert_array_equal(episode.column(RGB), [np.zeros_like(a), a])


def test_a_missing_image_is_flagged_unless_the_row_says_why(tmp_path: Path) -> None:
    (a,) = images(1)
    flags = [None, None, FrameFlag.REPEATED, FrameFlag.DROPPED]
    rows = [row(a if i == 0 else None, 0, None if flag is None else int(flag)) for i, flag in enumerate(flags)]
    episode = record(tmp_path, rows)
    assert episode.flags("wrist").tolist() == [0, FrameFlag.MISSING, FrameFlag.REPEATED, FrameFlag.DROPPED]
    counts = episode.timing["cameras"][RGB]
    assert [counts[name] for name in ("repeated", "stale", "missing", "dropped", "new_images")] == [1, 0, 1, 1, 1]


@pytest.mark.parametrize("flushes", [1, 3, 64])
def test_a_held_value_is_in_every_row(tmp_path: Path, flushes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs_data.record.rows._CAPACITY", flushes)
    values = [0.0, 0.0, 1.0, 1.0, 1.0, 0.0, -0.0, 2.0]
    (a,) = images(1)
    episode = record(tmp_path, [row(a, value) for value in values])
    np.testing.assert_array_equal(episode.column(MATRIX)[:, 0, 0], values)
    assert np.signbit(episode.column(MATRIX)[6]).all()  # -0 is not 0
    assert episode.steps([MATRIX]).column(MATRIX).null_count == 0


def test_the_content_does_not_depend_on_how_the_stream_was_flushed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = images(2)
    rows = [row(a, 0), row(None, 0, 1), row(b, 1), row(None, 1, 1)]
    hashes: set[str] = set()
    for capacity in (1, 2, 64):
        monkeypatch.setattr("rcs_data.record.rows._CAPACITY", capacity)
        hashes.add(record(tmp_path / str(capacity), rows).content_hash)
    assert len(hashes) == 1


def test_flags_do_not_count_as_content(tmp_path: Path) -> None:
    a, b = images(2)
    first = record(tmp_path / "a", [row(a, 0), row(b, 0)])
    second = record(tmp_path / "b", [row(a, 0), row(b, 0, int(FrameFlag.STALE))])
    assert first.content_hash == second.content_hash


def test_what_is_held_passes_the_check(tmp_path: Path) -> None:
    (a,) = images(1)
    record(tmp_path, [row(None, 0), row(a, 0), row(None, 0, 1), row(a, 3)])
    report = check(tmp_path)
    assert report.is_ok, str(report)
    assert report.frames == 4
