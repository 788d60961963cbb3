from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature
from rcs_data.convert.options import ExportOptions
from rcs_data.convert.rlds.export import export_rlds
from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.read.trajectory import action_layout, state_layout, trajectory

Examples = Callable[[Path], list[dict[str, Any]]]


@pytest.fixture
def examples(read_records: Any, parse_example: Any) -> Examples:
    def read(folder: Path) -> list[dict[str, Any]]:
        return [parse_example(record) for path in sorted(folder.glob("*.tfrecord-*")) for record in read_records(path)]

    return read


def test_every_step_has_what_was_seen_and_what_was_done_then(dataset: Path, tmp_path: Path, examples: Examples) -> None:
    source = Dataset.open(dataset)
    report = export_rlds(source, tmp_path / "out")
    assert report.path == tmp_path / "out/dataset/1.0.0"
    found = examples(report.path)
    assert len(found) == len(source) == report.episodes
    state, action = state_layout(source.info), action_layout(source.info)
    for episode, example in zip(source.episodes, found, strict=True):
        steps = trajectory(episode, state, action)
        np.testing.assert_array_equal(example["steps/observation/state"], np.float32(steps.states).reshape(-1))
        np.testing.assert_array_equal(example["steps/action"], np.float32(steps.actions).reshape(-1))
        np.testing.assert_array_equal(example["steps/reward"], np.float32(steps.rewards))
        joints = episode.column("observation/joints")[:-1].astype(np.float32)
        np.testing.assert_array_equal(example["steps/observation/joints"], joints.reshape(-1))
        last = len(steps) - 1
        assert example["steps/is_first"] == [int(i == 0) for i in range(len(steps))]
        assert example["steps/is_last"] == [int(i == last) for i in range(len(steps))]
        assert example["steps/is_terminal"] == [int(i == last) for i in range(len(steps))]
        assert example["steps/discount"].tolist() == [float(i != last) for i in range(len(steps))]
        assert example["steps/language_instruction"] == [b"pick the cuboid"] * len(steps)


def test_colour_is_in_the_recorded_bytes_and_depth_in_the_recorded_pixels(
    dataset: Path, tmp_path: Path, examples: Examples
) -> None:
    source = Dataset.open(dataset)
    for episode, example in zip(source.episodes, examples(export_rlds(source, tmp_path / "out").path), strict=True):
        colour = list(episode.encoded_frames("observation/frames/wrist/rgb"))
        assert example["steps/observation/image_wrist"] == colour[:-1]
        depth = [_decoded(data, "gray16le") for data in example["steps/observation/depth_wrist"]]
        np.testing.assert_array_equal(depth, episode.column("observation/frames/wrist/depth")[:-1])


def test_colour_that_was_recorded_without_loss_stays_without(tmp_path: Path, examples: Examples) -> None:
    source = _varied(tmp_path / "source")
    report = export_rlds(source, tmp_path / "out")
    assert _features(report.path)["steps/observation/image_left_wrist"]["image"]["encodingFormat"] == "png"
    for episode, example in zip(source.episodes, examples(report.path), strict=True):
        colour = [_decoded(data, "rgb24") for data in example["steps/observation/image_left_wrist"]]
        np.testing.assert_array_equal(colour, episode.column("observation/frames/left/wrist/rgb")[:-1])


def test_the_description_fits_every_example(tmp_path: Path, examples: Examples) -> None:
    source = _varied(tmp_path / "source")
    report = export_rlds(source, tmp_path / "out", ExportOptions(extra=("executed/left/joints", "time/monotonic")))
    features = _features(report.path)
    assert {"steps/executed_left_joints", "steps/time_monotonic"} <= set(features)
    for episode, example in zip(source.episodes, examples(report.path), strict=True):
        assert set(example) == set(features)
        for path, spec in features.items():
            rows = episode.length - 1 if path.startswith("steps/") else 1
            shape = [int(n) for n in spec.get("tensor", {}).get("shape", {}).get("dimensions", [])]
            assert len(example[path]) == rows * int(np.prod(shape)), path


def test_integers_are_whole_and_booleans_are_not_floats(tmp_path: Path, examples: Examples) -> None:
    source = _varied(tmp_path / "source")
    report = export_rlds(source, tmp_path / "out")
    kinds = {path: spec["tensor"]["dtype"] for path, spec in _features(report.path).items() if "tensor" in spec}
    assert kinds["steps/observation/count"] == "int32"
    assert kinds["steps/observation/clock"] == "uint64"
    assert kinds["steps/observation/touch"] == kinds["steps/is_first"] == "bool"
    for episode, example in zip(source.episodes, examples(report.path), strict=True):
        assert example["steps/observation/count"] == episode.column("observation/count")[:-1].reshape(-1).tolist()
        clock = np.array(example["steps/observation/clock"]).view(np.uint64)
        np.testing.assert_array_equal(clock, episode.column("observation/clock")[:-1])


def test_two_robots_and_any_words_keep_their_names(tmp_path: Path, examples: Examples) -> None:
    source = _varied(tmp_path / "source")
    report = export_rlds(source, tmp_path / "out")
    example = examples(report.path)[0]
    assert {f"steps/observation/{side}_joints" for side in ("left", "right")} <= set(example)
    assert example["steps/language_instruction"][0].decode() == "立方体を持ち上げる – é"
    described = json.loads((report.path / "rcs.json").read_text())
    assert [(part["key"], part["start"], part["end"]) for part in described["state"]] == [
        ("observation/left/joints", 0, 2),
        ("observation/right/joints", 2, 4),
    ]


def test_an_episode_says_where_it_came_from(dataset: Path, tmp_path: Path, examples: Examples) -> None:
    source = Dataset.open(dataset)
    for episode, example in zip(source.episodes, examples(export_rlds(source, tmp_path / "out").path), strict=True):
        about = {name.split("/")[1]: value for name, value in example.items() if name.startswith("episode_metadata")}
        assert about["episode_id"] == [episode.id.encode()]
        assert about["file_path"] == [f"dataset/{episode.id}".encode()]
        assert about["seed"] == [episode.seed]
        assert about["success"] == [int(bool(episode.success))]
        assert json.loads(about["provenance"][0])["content_hash"] == episode.content_hash


def test_what_nobody_knows_is_minus_one(tmp_path: Path, examples: Examples) -> None:
    source = _varied(tmp_path / "source")
    example = examples(export_rlds(source, tmp_path / "out").path)[0]
    assert example["episode_metadata/seed"] == example["episode_metadata/success"] == [-1]


def test_the_counts_are_those_of_the_files(tmp_path: Path, make_info: Any, read_records: Any) -> None:
    info = make_info(
        sim_state_size=None,
        features=(
            Feature(key="observation/x", shape=(50_000,), dtype="float32"),
            Feature(key="action/x", shape=(1,), dtype="float32"),
        ),
    )
    with DatasetWriter.open(tmp_path / "source", info) as writer:
        for i in range(3):
            with writer.episode(f"{i}", seed=i) as episode:
                for row in range(3):
                    done = {"action/x": np.ones(1, np.float32)} if row else {}
                    episode.add({"observation/x": np.ones(50_000, np.float32), **done})
                episode.finish(True)
    source = Dataset.open(tmp_path / "source")
    report = export_rlds(source, tmp_path / "out", ExportOptions(name="Few_2", shard_mb=1))
    about = json.loads((report.path / "dataset_info.json").read_text())
    assert (about["name"], about["version"], about["fileFormat"]) == ("Few_2", "1.0.0", "tfrecord")
    (split,) = about["splits"]
    files = sorted(report.path.glob("*.tfrecord-*"))
    assert len(files) > 1
    assert [path.name for path in files] == [
        f"Few_2-train.tfrecord-{i:05d}-of-{len(files):05d}" for i in range(len(files))
    ]
    records = [read_records(path) for path in files]
    assert [int(length) for length in split["shardLengths"]] == [len(found) for found in records]
    assert int(split["numBytes"]) == sum(len(record) for found in records for record in found)
    assert report.bytes_written == sum(path.stat().st_size for path in report.path.iterdir())


def test_episodes_and_cameras_are_chosen(dataset: Path, tmp_path: Path, examples: Examples) -> None:
    source = Dataset.open(dataset)
    options = ExportOptions(episodes=("000002", "000001", "000000"), success_only=True, cameras=())
    report = export_rlds(source, tmp_path / "out", options)
    found = examples(report.path)
    assert [example["episode_metadata/episode_id"] for example in found] == [[b"000002"], [b"000000"]]
    assert report.frames == 0 and not [name for name in found[0] if "wrist" in name]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (ExportOptions(extra=("observation/frames/wrist/rgb",)), "cannot be extra"),
        (ExportOptions(name="pick-cuboid"), "letters, digits"),
        (ExportOptions(name="3pick"), "first a letter"),
    ],
)
def test_what_makes_no_export_is_refused_and_leaves_nothing(
    dataset: Path, tmp_path: Path, options: ExportOptions, message: str
) -> None:
    with pytest.raises(InvalidSetup, match=message):
        export_rlds(Dataset.open(dataset), tmp_path / "out", options)
    assert not (tmp_path / "out").exists()


def test_exports_stand_side_by_side_and_none_is_written_over(dataset: Path, tmp_path: Path) -> None:
    source = Dataset.open(dataset)
    export_rlds(source, tmp_path / "out", ExportOptions(name="a"))
    export_rlds(source, tmp_path / "out", ExportOptions(name="b"))
    with pytest.raises(DatasetError, match="exists already"):
        export_rlds(source, tmp_path / "out", ExportOptions(name="a"))
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a", "b"]


@pytest.mark.parametrize(("folder", "name"), [("Pick-Cuboid 2", "pick_cuboid_2"), ("3d", "rcs_3d"), ("é", "rcs")])
def test_the_folder_gives_the_name(tmp_path: Path, folder: str, name: str) -> None:
    source = _varied(tmp_path / folder)
    assert export_rlds(source, tmp_path / "out").path == tmp_path / "out" / name / "1.0.0"


def test_two_parts_of_one_name_are_refused(tmp_path: Path) -> None:
    keys = ("observation/left/joints", "observation/left_joints", "action/joints")
    info = DatasetInfo(
        frequency=10,
        features=tuple(Feature(key=key, shape=(1,), dtype="float64") for key in keys),
        setup={},
        instruction="",
    )
    with DatasetWriter.open(tmp_path / "source", info) as writer, writer.episode("a", seed=1) as episode:
        for i in range(3):
            episode.add({key: np.zeros(1) for key in keys if i or not key.startswith("action")})
        episode.finish(True)
    with pytest.raises(InvalidSetup, match="'left_joints'"):
        export_rlds(Dataset.open(tmp_path / "source"), tmp_path / "out")


def test_progress_ends_at_the_number_of_steps(dataset: Path, tmp_path: Path) -> None:
    calls: list[tuple[int, int]] = []
    report = export_rlds(
        Dataset.open(dataset),
        tmp_path / "out",
        ExportOptions(on_progress=lambda done, total: calls.append((done, total))),
    )
    assert calls[-1] == (report.steps, report.steps) and len(calls) == report.episodes


def _varied(path: Path) -> Dataset:
    """Two robots, colour without loss, integers, booleans, an unknown seed and success."""
    numbers = [
        Feature(key=f"{group}/{side}/joints", shape=(2,), dtype="float64")
        for group in ("observation", "action", "executed")
        for side in ("left", "right")
    ]
    features = (
        *numbers,
        Feature(key="observation/count", shape=(2,), dtype="int32"),
        Feature(key="observation/touch", shape=(3,), dtype="bool"),
        Feature(key="observation/clock", shape=(), dtype="uint64"),
        Feature(key="observation/frames/left/wrist/extrinsics", shape=(4, 4), dtype="float64", encoding="held"),
        Feature(key="observation/frames/left/wrist/rgb", shape=(6, 8, 3), dtype="uint8", encoding="lossless"),
        Feature(key="time/monotonic", shape=(), dtype="float64"),
    )
    info = DatasetInfo(frequency=12.5, features=features, setup={}, instruction="立方体を持ち上げる – é")
    rng = np.random.default_rng(0)
    with DatasetWriter.open(path, info) as writer:
        for i in range(2):
            with writer.episode(f"{i}", seed=None) as episode:
                for row in range(4):
                    episode.add({f.key: _any(f, rng) for f in features if row or not f.is_unknown_at_reset})
                episode.finish(None)
    return Dataset.open(path)


def _any(feature: Feature, rng: np.random.Generator) -> Any:
    if feature.dtype == "float64":
        return rng.normal(size=feature.shape)
    if feature.dtype == "bool":
        return rng.random(feature.shape) < 0.5
    limits = np.iinfo(feature.dtype)
    return rng.integers(limits.min, limits.max, feature.shape, feature.dtype, endpoint=True)


def _features(folder: Path) -> dict[str, Any]:
    return dict(_leaves("", json.loads((folder / "features.json").read_text())))


def _leaves(path: str, spec: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    kind = spec["pythonClassName"].removeprefix("tensorflow_datasets.core.features.")
    if kind == "features_dict.FeaturesDict":
        for name, inner in spec["featuresDict"]["features"].items():
            yield from _leaves(f"{path}/{name}".lstrip("/"), inner)
    elif kind == "dataset_feature.Dataset":
        assert path == "steps" and spec["sequence"]["length"] == "-1"
        yield from _leaves(path, spec["sequence"]["feature"])
    else:
        assert kind in ("tensor_feature.Tensor", "scalar.Scalar", "text_feature.Text", "image_feature.Image")
        yield path, spec


def _decoded(data: bytes, pixels: str) -> Any:
    with av.open(io.BytesIO(data), format="png_pipe") as file:
        return next(file.decode(video=0)).to_ndarray(format=pixels)
