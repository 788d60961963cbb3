from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rcs_data import DatasetInfo, DatasetWriter, Feature, check
from rcs_data.check.report import Finding
from rcs_data.files.flags import FrameFlag

if TYPE_CHECKING:
    from conftest import MakeMoving, Rows

RGB, FLAGS = "observation/frames/wrist/rgb", "flags/frames/wrist"


def found(path: Path) -> list[Finding]:
    return list(check(path).findings)


@pytest.mark.parametrize("as_new", [True, False], ids=["given again", "not given"])
def test_a_frozen_camera_is_found_where_the_robot_moves(tmp_path: Path, moving: MakeMoving, as_new: bool) -> None:
    def freeze(rows: Rows) -> None:
        for row in rows[31:90]:
            row[RGB] = rows[30][RGB] if as_new else None
            row[FLAGS] = 0 if as_new else int(FrameFlag.REPEATED)

    (finding,) = found(moving(tmp_path, freeze))
    assert (finding.severity, finding.kind, finding.rows) == ("warning", "frozen", (30, 89))
    assert "'wrist' is frozen for 2.0 s" in finding.message


def test_a_camera_that_sees_a_robot_at_rest_is_not_frozen(tmp_path: Path, moving: MakeMoving) -> None:
    def rest(rows: Rows) -> None:
        for row in rows[31:90]:
            row[RGB] = rows[30][RGB]
        for row in rows:
            row["observation/joints"] = rows[0]["observation/joints"]

    assert found(moving(tmp_path, rest)) == []


def test_a_slow_camera_is_not_frozen(tmp_path: Path, moving: MakeMoving) -> None:
    def slow(rows: Rows) -> None:
        for i, row in enumerate(rows):
            if i % 35:
                row[RGB], row[FLAGS] = None, int(FrameFlag.REPEATED)

    assert found(moving(tmp_path, slow, length=350)) == []


def test_frames_that_come_twice_as_new_are_found(tmp_path: Path, moving: MakeMoving) -> None:
    def fast(rows: Rows) -> None:
        start = rows[0]["observation/joints"]
        for i, row in enumerate(rows):
            row["observation/joints"] = start + 0.4 * np.sin(i / 5)
        for i in range(1, len(rows), 2):
            rows[i][RGB] = rows[i - 1][RGB]

    (finding,) = found(moving(tmp_path, fast))
    assert finding.kind == "repeated_images"


def test_a_wrist_that_rises_from_a_bare_table_is_no_repeat(tmp_path: Path, moving: MakeMoving) -> None:
    def bare(rows: Rows) -> None:
        start = rows[0]["observation/joints"]
        for i, row in enumerate(rows):
            row["observation/joints"] = start + 0.03 * min(i, 60)
        for row in [*rows[12:30], *rows[40:58]]:
            row[RGB] = rows[11][RGB]

    assert found(moving(tmp_path, bare)) == []


def test_black_images_are_found_row_by_row(tmp_path: Path, moving: MakeMoving) -> None:
    def cover(rows: Rows) -> None:
        for row in rows[7:9]:
            row[RGB] = np.zeros_like(row[RGB])

    path = moving(tmp_path, cover)
    (finding,) = found(path)
    assert (finding.kind, finding.rows) == ("black", (7, 8))
    assert not check(path, depth="rows").findings, "without decoding nobody knows"


@pytest.mark.parametrize(("length", "is_found"), [(1, False), (2, True)])
def test_an_episode_of_one_step_is_long_enough(tmp_path: Path, moving: MakeMoving, length: int, is_found: bool) -> None:
    def cover(rows: Rows) -> None:
        for row in rows:
            row[RGB] = np.zeros_like(row[RGB])

    kinds = [finding.kind for finding in found(moving(tmp_path, cover, length=length))]
    assert ("black" in kinds) == is_found


def test_the_touch_of_nothing_is_not_frozen(tmp_path: Path, moving: MakeMoving) -> None:
    def touch_nothing(rows: Rows) -> None:
        for row in rows:
            row[RGB] = rows[0][RGB]

    setup: dict[str, Any] = {"robot": "fr3", "stepping": "realtime", "cameras": {"names": []}, "tactile": "digit"}
    assert found(moving(tmp_path / "tactile", touch_nothing, setup=setup)) == []
    setup["cameras"] = {"names": ["wrist"]}
    (finding,) = found(moving(tmp_path / "beside", touch_nothing, setup=setup))
    assert finding.kind == "frozen"
    assert [finding.kind for finding in found(moving(tmp_path / "camera", touch_nothing))] == ["frozen"]


@pytest.mark.parametrize("shape", [(), (2, 2)])
def test_joints_of_any_shape_are_checked(tmp_path: Path, shape: tuple[int, ...]) -> None:
    features = (
        Feature(key="observation/joints", shape=shape, dtype="float64"),
        Feature(key=RGB, shape=(8, 12, 3), dtype="uint8", encoding="jpeg"),
    )
    info = DatasetInfo(frequency=30.0, features=features, setup={}, instruction="move")
    with DatasetWriter.open(tmp_path, info) as writer, writer.episode("a", seed=0) as episode:
        for row in range(4):
            image = np.full((8, 12, 3), 40 * row + 20, np.uint8)
            episode.add({"observation/joints": np.full(shape, row / 10)[()], RGB: image})
        episode.finish(True)
    assert found(tmp_path) == []
