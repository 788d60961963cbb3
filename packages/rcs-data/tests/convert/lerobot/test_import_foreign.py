"""Datasets of others in the formats of LeRobot: plain names, odd stamps, files in tables, tasks per frame."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import simplejpeg
from rcs_data import Dataset, Windows, check
from rcs_data.convert.labels import row_texts
from rcs_data.convert.lerobot.export import export_lerobot
from rcs_data.convert.lerobot.import_ import import_lerobot
from rcs_data.convert.lerobot.source import LeRobotSource
from rcs_data.convert.options import ExportOptions, ImportOptions
from rcs_data.read.trajectory import action_layout, camera_features, state_layout

WORDS = ("pick up the green cuboid", "nimm den grünen Würfel – 拿起方块")


def foreign(source: Dataset, out: Path, version: Any, **options: Any) -> Path:
    """Make an export that says nothing of where it came from."""
    export_lerobot(source, out, ExportOptions(**options), version=version)
    for path in out.glob("meta/rcs*"):
        path.unlink()
    shutil.rmtree(out / "rcs", ignore_errors=True)
    return out


def described(root: Path, **features: Any) -> None:
    """Add features to the description of a LeRobot dataset; None removes one."""
    path = root / "meta" / "info.json"
    info = json.loads(path.read_text())
    info["features"] = {k: v for k, v in {**info["features"], **features}.items() if v is not None}
    path.write_text(json.dumps(info))


def changed(root: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    """Change the tables of a LeRobot dataset."""
    for path in sorted((root / "data").glob("*/*.parquet")):
        pq.write_table(change(pq.read_table(path)), path)


@pytest.mark.parametrize("version", ["3.0", "2.1"])
def test_others_datasets_come_in_under_plain_names(source: Dataset, tmp_path: Path, version: Any) -> None:
    given = foreign(source, tmp_path / "lerobot", version, extra=("observation/xyzrpy",))
    back = import_lerobot(given, tmp_path / "back")
    forms = {f.key: (f.shape, f.dtype) for f in back.info.features}
    assert forms["observation/state"] == ((4,), "float32")
    assert forms["action/action"] == ((4,), "float32")
    assert forms["observation/xyzrpy"] == ((6,), "float64")
    assert forms["reward"] == ((), "float32")
    assert forms["observation/frames/side/rgb"] == ((32, 48, 3), "uint8")
    assert forms["extra/next.done"] == ((), "bool")
    for old, new in zip(source.episodes, back.episodes, strict=True):
        assert new.length == old.length
        actions = new.column("action/action")
        np.testing.assert_array_equal(actions[1:, :3], old.column("action/joints")[1:].astype(np.float32))
        assert np.isnan(actions[0]).all()
        states = new.column("observation/state")
        np.testing.assert_array_equal(states[:-1, :3], old.column("observation/joints")[:-1].astype(np.float32))
        assert new.success == old.success
        assert new.instruction == old.instruction
        assert new.seed is None
    assert [episode.id for episode in back.episodes] == ["000000", "000001", "000002"]
    assert back.info.setup["imported"]["names"]["action"] == ["joints_0", "joints_1", "joints_2", "gripper"]
    # The source has a number that is none, where no period was measured; it is kept and found.
    assert all("time.period" in finding.message for finding in check(tmp_path / "back").findings)


def test_an_observation_that_was_never_stored_is_repeated_and_says_so(source: Dataset, tmp_path: Path) -> None:
    back = import_lerobot(foreign(source, tmp_path / "lerobot", "3.0"), tmp_path / "back")
    for episode in back.episodes:
        assert episode.outcome["imported"]["last_observation"] == "repeated"
        states = episode.column("observation/state")
        np.testing.assert_array_equal(states[-1], states[-2])
        images = episode.column("observation/frames/side/rgb")
        np.testing.assert_array_equal(images[-1], images[-2])


def test_success_stays_unknown_where_the_source_does_not_say(make_dataset: Any, tmp_path: Path) -> None:
    given = foreign(make_dataset(success=(True, None)), tmp_path / "lerobot", "3.0")
    assert [e.success for e in import_lerobot(given, tmp_path / "back").episodes] == [None, None, None]


def test_stamps_off_the_grid_are_kept_as_times(make_dataset: Any, tmp_path: Path) -> None:
    given = foreign(make_dataset(cameras=False), tmp_path / "lerobot", "3.0")
    path = given / "data" / "chunk-000" / "file-000.parquet"
    table = pq.read_table(path)
    stamps = table.column("timestamp").to_numpy() + 0.01 * np.arange(len(table), dtype=np.float32)
    pq.write_table(table.set_column(table.column_names.index("timestamp"), "timestamp", pa.array(stamps)), path)
    first = import_lerobot(given, tmp_path / "back").episodes[0].column("time/timestamp")
    np.testing.assert_array_equal(first[:-1], stamps[:6])
    assert np.isnan(first[-1])


def test_images_in_the_tables_and_columns_of_words_are_met(make_dataset: Any, tmp_path: Path) -> None:
    given = foreign(make_dataset(cameras=False), tmp_path / "lerobot", "2.1")
    # Channels first, as old datasets have it.
    described(
        given,
        wrist_image={"dtype": "image", "shape": [3, 8, 8], "names": ["channel", "height", "width"]},
        note={"dtype": "string", "shape": [1], "names": None},
        history={"dtype": "string", "shape": [4], "names": None},
    )
    encoder = av.CodecContext.create("png", "w")
    encoder.width, encoder.height, encoder.pix_fmt = 8, 8, "rgb24"
    picture = np.random.default_rng(0).integers(0, 256, (8, 8, 3), np.uint8)
    png = b"".join(bytes(p) for p in encoder.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
    changed(
        given,
        lambda table: table.append_column(
            "wrist_image", pa.array([{"bytes": png, "path": "x.png"}] * len(table))
        ).append_column("note", pa.array([f"hm {n // 2}" for n in range(len(table))])),
    )
    back = import_lerobot(given, tmp_path / "back", ImportOptions(lossless=True))
    image = back.episodes[0].column("observation/frames/wrist_image/rgb")[0]
    np.testing.assert_array_equal(image, picture)
    assert row_texts(back.episodes[0], "extra/note") == ["hm 0", "hm 0", "hm 1", "hm 1", "hm 2", "hm 2", "hm 2"]
    assert "history" in back.info.setup["imported"]["left_out"]
    export_lerobot(back, tmp_path / "again", ExportOptions(extra=("extra/note",)))
    again = pq.read_table(tmp_path / "again" / "data" / "chunk-000" / "file-000.parquet")
    assert again.column("note").to_pylist()[:6] == ["hm 0", "hm 0", "hm 1", "hm 1", "hm 2", "hm 2"]


def test_names_of_openpi_become_observation_and_action(make_dataset: Any, tmp_path: Path) -> None:
    given = foreign(make_dataset(), tmp_path / "lerobot", "2.1", cameras=("side", "wrist"))
    names = {"observation.state": "state", "action": "actions"}
    info = json.loads((given / "meta" / "info.json").read_text())
    mask = {"dtype": "bool", "shape": [1], "names": None}
    described(
        given,
        **dict.fromkeys(names),
        **{new: info["features"][old] for old, new in names.items()},
        **{"image": info["features"]["observation.images.side"], "observation.images.side": None},
        **{"wrist_image": info["features"]["observation.images.wrist"], "observation.images.wrist": None},
        action_mask=mask,
    )
    for old, new in (("side", "image"), ("wrist", "wrist_image")):
        folder = given / "videos" / "chunk-000"
        (folder / f"observation.images.{old}").rename(folder / new)
    changed(
        given,
        lambda table: table.rename_columns([names.get(n, n) for n in table.column_names]).append_column(
            "action_mask", pa.array([True] * len(table))
        ),
    )
    back = import_lerobot(given, tmp_path / "back")
    assert [f.key for f in state_layout(back.info).features] == ["observation/state"]
    assert [f.key for f in action_layout(back.info).features] == ["action/action"]
    assert list(camera_features(back.info)) == ["image", "wrist_image"]
    assert back.episodes[0].column("extra/action_mask").tolist() == [True] * 7
    assert Windows(back, horizon=2)[0]["actions"].shape == (2, 4)
    export_lerobot(back, tmp_path / "again")
    again = json.loads((tmp_path / "again" / "meta" / "info.json").read_text())["features"]
    assert (again["action"]["shape"], again["observation.state"]["shape"]) == ([4], [4])


@pytest.mark.parametrize("version", ["3.0", "2.1"])
def test_tasks_and_subtasks_of_every_frame_survive(make_dataset: Any, tmp_path: Path, version: Any) -> None:
    given = foreign(make_dataset(cameras=False), tmp_path / "lerobot", version)
    tasks = pa.table({"subtask_index": [0, 1], "subtask": ["reach", "grasp"]})
    pq.write_table(tasks, given / "meta" / "subtasks.parquet")
    described(given, subtask_index={"dtype": "int64", "shape": [1], "names": None})

    def change(table: pa.Table) -> pa.Table:
        halves = pa.array([n % 2 for n in range(len(table))], pa.int64())
        at = table.column_names.index("task_index")
        return table.set_column(at, "task_index", halves).append_column("subtask_index", halves)

    changed(given, change)
    back = import_lerobot(given, tmp_path / "back")
    words = [WORDS[0], WORDS[1]] * 3
    assert row_texts(back.episodes[0], "extra/task_index") == [*words, words[-1]]
    assert row_texts(back.episodes[0], "extra/subtask_index")[:3] == ["reach", "grasp", "reach"]
    assert back.episodes[0].instruction == WORDS[0]
    export_lerobot(back, tmp_path / "again", version=version)
    tables = [
        pa.concat_tables(pq.read_table(p) for p in sorted((tmp_path / n / "data").glob("*/*.parquet")))
        for n in ("lerobot", "again")
    ]
    known = dict(enumerate(WORDS)), {v: k for k, v in LeRobotSource(tmp_path / "again").tasks.items()}
    told = [known[0][i] for i in tables[0].column("task_index").to_pylist()]
    assert [known[1][text] for text in told] == tables[1].column("task_index").to_pylist()
    texts = LeRobotSource(tmp_path / "again").subtasks
    assert [texts[i] for i in tables[1].column("subtask_index").to_pylist()][:2] == ["reach", "grasp"]
    third = import_lerobot(tmp_path / "again", tmp_path / "third")
    for one, other in zip(back.episodes, third.episodes, strict=True):
        for key in ("extra/task_index", "extra/subtask_index"):
            assert row_texts(one, key) == row_texts(other, key)


def test_jpeg_files_in_tables_stay_as_they_are(make_dataset: Any, tmp_path: Path) -> None:
    given = foreign(make_dataset(cameras=False), tmp_path / "lerobot", "2.1")
    described(given, image={"dtype": "image", "shape": [8, 16, 3], "names": ["height", "width", "channel"]})
    jpeg = simplejpeg.encode_jpeg(np.random.default_rng(0).integers(0, 256, (8, 16, 3), np.uint8), 80)
    changed(given, lambda t: t.append_column("image", pa.array([{"bytes": jpeg, "path": "x.jpg"}] * len(t))))
    back = import_lerobot(given, tmp_path / "back")
    assert set(back.episodes[0].encoded_frames("observation/frames/image/rgb")) == {jpeg}
