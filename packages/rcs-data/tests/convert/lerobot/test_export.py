"""An export has the layout that LeRobot's readers expect, down to types and names, and nothing that is not true."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray
from rcs_data import Dataset
from rcs_data.convert.lerobot import export as lerobot
from rcs_data.convert.lerobot.export import export_lerobot
from rcs_data.convert.lerobot.layout import lerobot_layout
from rcs_data.convert.lerobot.stats import QUANTILES
from rcs_data.convert.lerobot.video import VideoReader
from rcs_data.convert.lerobot.writer import V3Writer
from rcs_data.convert.options import ExportOptions
from rcs_data.errors import InvalidSetup
from rcs_data.read.trajectory import action_layout, state_layout, trajectory

SIDE, WRIST = "observation.images.side", "observation.images.wrist"


def load(path: Path) -> Any:
    return json.loads(path.read_text())


def lines(path: Path) -> list[Any]:
    return [json.loads(line) for line in path.read_text().split("\n") if line]


def vectors(table: pa.Table, name: str) -> NDArray[Any]:
    column = table.column(name).combine_chunks()
    return column.flatten().to_numpy().reshape(len(table), -1)


def frames_of(path: Path) -> int:
    with av.open(str(path)) as source:
        return sum(1 for _ in source.decode(video=0))


def test_v3_has_its_files_and_describes_them(source: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "out"
    report = export_lerobot(source, out)
    steps = 6 + 7 + 8
    assert (report.episodes, report.steps, report.frames) == (3, steps, 2 * steps)
    info = load(out / "meta" / "info.json")
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (3, steps, 2)
    assert isinstance(info["fps"], int)
    assert info["robot_type"] == "fr3"
    assert info["splits"] == {"train": "0:3"}
    assert (info["chunks_size"], info["data_files_size_in_mb"], info["video_files_size_in_mb"]) == (1000, 100, 200)
    place = {"chunk_index": 0, "file_index": 0}
    table = pq.read_table(out / info["data_path"].format(**place))
    assert table.num_rows == steps
    for camera in (SIDE, WRIST):
        assert info["features"][camera]["dtype"] == "video"
        assert info["features"][camera]["shape"] == [32, 48, 3]
        assert info["features"][camera]["info"]["video.codec"] == "h264"
        assert frames_of(out / info["video_path"].format(video_key=camera, **place)) == steps
    numbers = {name: f for name, f in info["features"].items() if f["dtype"] != "video"}
    assert set(numbers) == set(table.column_names)
    assert not any("/" in name for name in info["features"])
    assert not list(out.parent.glob("*partial*"))


def test_the_columns_have_the_types_that_the_reader_casts_to(source: Dataset, tmp_path: Path) -> None:
    export_lerobot(source, tmp_path / "out")
    schema = pq.read_schema(tmp_path / "out" / "data" / "chunk-000" / "file-000.parquet")
    assert schema.field("observation.state").type == pa.list_(pa.float32(), 4)
    assert schema.field("action").type == pa.list_(pa.float32(), 4)
    assert schema.field("timestamp").type == pa.float32()
    for name in ("frame_index", "episode_index", "index", "task_index"):
        assert schema.field(name).type == pa.int64()
    assert schema.field("next.done").type == pa.bool_()
    described = json.loads(schema.metadata[b"huggingface"])["info"]["features"]
    # "List" is not known to the versions of `datasets` that read v2.1.
    assert described["action"] == {
        "feature": {"dtype": "float32", "_type": "Value"},
        "length": 4,
        "_type": "Sequence",
    }
    assert list(described) == schema.names


@pytest.mark.parametrize("version", ["3.0", "2.1"])
def test_a_frame_has_what_was_seen_beside_what_was_done_then(source: Dataset, tmp_path: Path, version: Any) -> None:
    export_lerobot(source, tmp_path / "out", version=version)
    table = pa.concat_tables(pq.read_table(path) for path in sorted((tmp_path / "out" / "data").glob("*/*.parquet")))
    state, action = state_layout(source.info), action_layout(source.info)
    flows = [trajectory(episode, state, action) for episode in source.episodes]
    expected = {
        "observation.state": np.concatenate([flow.states for flow in flows]),
        "action": np.concatenate([flow.actions for flow in flows]),
    }
    for name, values in expected.items():
        np.testing.assert_array_equal(vectors(table, name), values.astype(np.float32))
    rewards = np.concatenate([flow.rewards for flow in flows]).astype(np.float32)
    np.testing.assert_array_equal(table.column("next.reward").to_numpy(), rewards)
    lengths = [len(flow) for flow in flows]
    ends = np.cumsum(lengths) - 1
    assert np.flatnonzero(table.column("next.done").to_numpy()).tolist() == ends.tolist()
    assert np.flatnonzero(table.column("next.success").to_numpy()).tolist() == [ends[0], ends[2]]
    frame = np.concatenate([np.arange(n) for n in lengths])
    np.testing.assert_array_equal(table.column("frame_index").to_numpy(), frame)
    np.testing.assert_array_equal(table.column("timestamp").to_numpy(), (frame / 30).astype(np.float32))
    np.testing.assert_array_equal(table.column("index").to_numpy(), np.arange(sum(lengths)))
    np.testing.assert_array_equal(table.column("task_index").to_numpy(), np.repeat([0, 1, 0], lengths))


def test_times_stay_as_they_were_measured(source: Dataset, tmp_path: Path) -> None:
    export_lerobot(source, tmp_path / "out")
    table = pq.read_table(tmp_path / "out" / "data" / "chunk-000" / "file-000.parquet")
    measured = np.concatenate([episode.column("time/monotonic")[:-1] for episode in source.episodes])
    np.testing.assert_array_equal(table.column("time.monotonic").to_numpy(), measured)
    assert np.isnan(table.column("time.period").to_numpy()[0])


def test_episodes_of_v3_are_found_in_shared_files(source: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export_lerobot(source, out)
    rows = pq.read_table(out / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pylist()
    assert [row["length"] for row in rows] == [6, 7, 8]
    assert [(row["dataset_from_index"], row["dataset_to_index"]) for row in rows] == [(0, 6), (6, 13), (13, 21)]
    np.testing.assert_allclose([row[f"videos/{SIDE}/from_timestamp"] for row in rows], [0, 6 / 30, 13 / 30])
    np.testing.assert_allclose([row[f"videos/{SIDE}/to_timestamp"] for row in rows], [6 / 30, 13 / 30, 21 / 30])
    reader = VideoReader(out / "videos" / SIDE / "chunk-000" / "file-000.mp4")
    for row, episode in zip(rows, source.episodes, strict=True):
        seen = np.stack(list(reader.frames(row[f"videos/{SIDE}/from_timestamp"], row["length"], 30)))
        truth = episode.column("observation/frames/side/rgb")[:-1]
        assert np.abs(seen.astype(float) - truth).mean() < 4
        assert np.shape(row[f"stats/{SIDE}/mean"]) == (3, 1, 1)
        np.testing.assert_allclose(np.ravel(row[f"stats/{SIDE}/mean"]), truth.mean(axis=(0, 1, 2)) / 255, atol=1e-9)
        assert row["stats/action/count"] == [row["length"]]


def test_tasks_are_indexed_by_their_words(source: Dataset, tmp_path: Path) -> None:
    export_lerobot(source, tmp_path / "out")
    table = pq.read_table(tmp_path / "out" / "meta" / "tasks.parquet")
    about = json.loads(table.schema.metadata[b"pandas"])
    assert about["index_columns"] == ["__index_level_0__"]
    assert table.column("task_index").to_pylist() == [0, 1]
    assert table.column("__index_level_0__").to_pylist() == [e.instruction for e in source.episodes[:2]]


@pytest.mark.parametrize("version", ["3.0", "2.1"])
def test_statistics_are_those_of_all_frames(source: Dataset, tmp_path: Path, version: Any) -> None:
    out = tmp_path / "out"
    export_lerobot(source, out, version=version)
    stats = load(out / "meta" / "stats.json")
    table = pa.concat_tables(pq.read_table(path) for path in sorted((out / "data").glob("*/*.parquet")))
    for name in ("observation.state", "action"):
        values = vectors(table, name).astype(np.float64)
        for what in ("min", "max", "mean", "std"):
            np.testing.assert_allclose(stats[name][what], getattr(values, what)(axis=0), err_msg=f"{name} {what}")
        for what, share in QUANTILES.items():
            np.testing.assert_allclose(stats[name][what], np.quantile(values, share, axis=0), err_msg=f"{name} {what}")
        assert stats[name]["count"] == [21]
    pixels = np.concatenate([e.column("observation/frames/side/rgb")[:-1] for e in source.episodes]) / 255
    np.testing.assert_allclose(np.ravel(stats[SIDE]["mean"]), pixels.mean(axis=(0, 1, 2)), atol=1e-9)
    assert np.shape(stats[SIDE]["std"]) == (3, 1, 1)


def test_v21_has_files_per_episode(source: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export_lerobot(source, out, version="2.1")
    info = load(out / "meta" / "info.json")
    assert info["codebase_version"] == "v2.1"
    assert (info["total_videos"], info["total_chunks"]) == (6, 1)
    for index, steps in enumerate((6, 7, 8)):
        where = {"episode_chunk": 0, "episode_index": index}
        assert pq.read_table(out / info["data_path"].format(**where)).num_rows == steps
        assert frames_of(out / info["video_path"].format(video_key=WRIST, **where)) == steps
    tasks = [episode.instruction for episode in source.episodes]
    assert lines(out / "meta" / "tasks.jsonl") == [{"task_index": i, "task": tasks[i]} for i in (0, 1)]
    assert [row["length"] for row in lines(out / "meta" / "episodes.jsonl")] == [6, 7, 8]
    assert [row["tasks"] for row in lines(out / "meta" / "episodes.jsonl")] == [[task] for task in tasks]
    stats = lines(out / "meta" / "episodes_stats.jsonl")
    assert [row["stats"]["action"]["count"] for row in stats] == [[6], [7], [8]]
    assert (out / "meta" / "info.json").read_bytes().isascii()
    assert (out / "meta" / "tasks.jsonl").read_bytes().isascii()


def test_gr00t_is_told_what_the_numbers_mean(make_dataset: Any, tmp_path: Path) -> None:
    dataset = make_dataset(robots=("left", "right"))
    export_lerobot(dataset, tmp_path / "out", version="2.1", gr00t=True)
    modality = load(tmp_path / "out" / "meta" / "modality.json")
    assert modality["state"] == {
        "left_joints": {"start": 0, "end": 3},
        "left_gripper": {"start": 3, "end": 4},
        "right_joints": {"start": 4, "end": 7},
        "right_gripper": {"start": 7, "end": 8},
    }
    assert modality["action"].keys() == modality["state"].keys()
    assert modality["video"] == {"side": {"original_key": SIDE}, "wrist": {"original_key": WRIST}}
    assert modality["annotation"] == {"human.task_description": {"original_key": "task_index"}}
    with pytest.raises(InvalidSetup, match="GR00T"):
        export_lerobot(dataset, tmp_path / "other", version="3.0", gr00t=True)


def test_files_start_anew_when_they_are_full(make_dataset: Any, tmp_path: Path) -> None:
    dataset = make_dataset(episodes=4)
    export_lerobot(dataset, tmp_path / "whole", version="2.1")
    layout = lerobot_layout(dataset.info, dataset.episodes, ExportOptions())
    small = tmp_path / "small"
    small.mkdir()
    tasks = lerobot._numbered(dataset.episodes, layout, lerobot.TASK)
    writer = V3Writer(small, layout, "fr3", [*tasks], [], data_limit=1, video_limit=1)
    first = 0
    for index, episode in enumerate(dataset.episodes):
        writer.add(lerobot._encoded(small, layout, tasks, {}, (index, first, episode)))
        first += episode.length - 1
    writer.finish()
    for kind in ("data/chunk-000/*", f"videos/{SIDE}/chunk-000/*", f"videos/{WRIST}/chunk-000/*"):
        assert len(list(small.glob(kind))) == 4
    rows = pq.read_table(small / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pylist()
    assert [row["data/file_index"] for row in rows] == [0, 1, 2, 3]
    assert [row[f"videos/{SIDE}/file_index"] for row in rows] == [0, 1, 2, 3]
    assert [row[f"videos/{SIDE}/from_timestamp"] for row in rows] == [0, 0, 0, 0]


def test_threads_change_nothing(source: Dataset, tmp_path: Path) -> None:
    for workers in (1, 3):
        export_lerobot(source, tmp_path / str(workers), ExportOptions(workers=workers))
    one, three = ({p.relative_to(r): p.read_bytes() for p in r.rglob("*") if p.is_file()}
                  for r in (tmp_path / "1", tmp_path / "3"))  # fmt: skip
    assert one == three


def test_depth_is_left_out_and_the_report_says_so(source: Dataset, tmp_path: Path) -> None:
    report = export_lerobot(source, tmp_path / "out")
    assert not any("depth" in name for name in load(tmp_path / "out" / "meta" / "info.json")["features"])
    assert any("Depth of side was left out" in note for note in report.notes)


def test_matrices_are_columns_of_every_frame(source: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export_lerobot(source, out, ExportOptions(cameras=("wrist",)))
    features = load(out / "meta" / "info.json")["features"]
    assert "calibration.side.extrinsics" not in features
    assert features["calibration.wrist.extrinsics"]["shape"] == [16]
    table = pq.read_table(out / "data" / "chunk-000" / "file-000.parquet")
    truth = np.concatenate([e.column("observation/frames/wrist/extrinsics")[:-1] for e in source.episodes])
    np.testing.assert_array_equal(vectors(table, "calibration.wrist.extrinsics").reshape(-1, 4, 4), truth)


def test_provenance_of_every_episode_is_kept(source: Dataset, tmp_path: Path) -> None:
    export_lerobot(source, tmp_path / "out", ExportOptions(episodes=("take-2", "take-1")))
    rows = lines(tmp_path / "out" / "meta" / "rcs_provenance.jsonl")
    assert [(row["episode_index"], row["episode"], row["seed"], row["success"]) for row in rows] == [
        (0, "take-2", 102, True),
        (1, "take-1", 101, False),
    ]
    assert [row["content_hash"] for row in rows] == [source[i].content_hash for i in ("take-2", "take-1")]
    assert len({row["dataset"] for row in rows}) == 1
    assert rows[1]["outcome"] == {"failure": "slip"}


def test_only_successes_are_exported_where_asked(source: Dataset, tmp_path: Path) -> None:
    report = export_lerobot(source, tmp_path / "out", ExportOptions(success_only=True))
    assert (report.episodes, report.steps) == (2, 14)


def test_success_is_not_claimed_where_nobody_said(make_dataset: Any, tmp_path: Path) -> None:
    report = export_lerobot(make_dataset(success=(True, None)), tmp_path / "out")
    assert "next.success" not in load(tmp_path / "out" / "meta" / "info.json")["features"]
    assert any("next.success" in note for note in report.notes)


def test_other_vectors_and_columns_are_taken_where_named(source: Dataset, tmp_path: Path) -> None:
    options = ExportOptions(
        state=("observation/xyzrpy", "observation/gripper"), action=("executed/joints",), cameras=("wrist",),
        extra=("observation/joints", "executed/joints"), robot_type="panda",
    )  # fmt: skip
    export_lerobot(source, tmp_path / "out", options)
    info = load(tmp_path / "out" / "meta" / "info.json")
    features = info["features"]
    assert info["robot_type"] == "panda"
    assert features["observation.state"]["names"] == [*(f"xyzrpy_{i}" for i in range(6)), "gripper"]
    assert features["action"]["shape"] == [3]
    assert features["observation.joints"]["dtype"] == "float64"
    assert SIDE not in features
    table = pq.read_table(tmp_path / "out" / "data" / "chunk-000" / "file-000.parquet")
    np.testing.assert_array_equal(vectors(table, "executed.joints").astype(np.float32), vectors(table, "action"))


def test_an_action_of_what_was_measured_before_the_step_is_refused(source: Dataset, tmp_path: Path) -> None:
    options = ExportOptions(action=("observation/xyzrpy", "action/gripper"))
    with pytest.raises(InvalidSetup, match=r"The action has observation/xyzrpy, measured before the step"):
        export_lerobot(source, tmp_path / "out", options)
    assert not (tmp_path / "out").exists()


def test_a_dataset_without_cameras_has_no_videos(make_dataset: Any, tmp_path: Path) -> None:
    for version in ("3.0", "2.1"):
        out = tmp_path / version
        assert export_lerobot(make_dataset(version, cameras=False), out / "x", version=version).frames == 0  # type: ignore[arg-type]
        assert load(out / "x" / "meta" / "info.json")["video_path"] is None
        assert not (out / "x" / "videos").exists()


def test_a_rate_that_is_no_whole_number_is_refused_or_claimed_knowingly(make_dataset: Any, tmp_path: Path) -> None:
    dataset = make_dataset(frequency=29.97, cameras=False)
    with pytest.raises(InvalidSetup, match=r"29\.97.*fps=30.*0\.10%"):
        export_lerobot(dataset, tmp_path / "out")
    report = export_lerobot(dataset, tmp_path / "out", ExportOptions(fps=30))
    assert load(tmp_path / "out" / "meta" / "info.json")["fps"] == 30
    assert load(tmp_path / "out" / "meta" / "rcs.json")["frequency"] == 29.97
    assert any("29.97" in note for note in report.notes)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"extra": ("observation/frames/side/rgb",)}, "cannot be a column"),
        ({"extra": ("observation/speed",)}, "no feature of this dataset named 'observation/speed'"),
        ({"codec": "av1"}, "AV1"),
    ],
)
def test_what_cannot_be_is_refused_and_leaves_nothing(
    source: Dataset, tmp_path: Path, options: dict[str, Any], words: str
) -> None:
    before = set(tmp_path.iterdir())
    with pytest.raises(InvalidSetup, match=words):
        export_lerobot(source, tmp_path / "out", ExportOptions(**options))
    assert set(tmp_path.iterdir()) == before


def test_progress_counts_all_steps(source: Dataset, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    export_lerobot(source, tmp_path / "out", ExportOptions(on_progress=lambda done, total: told.append((done, total))))
    assert told == [(6, 21), (13, 21), (21, 21)]
