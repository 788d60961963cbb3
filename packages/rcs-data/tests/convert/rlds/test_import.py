from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import simplejpeg
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, Windows, check
from rcs_data.convert.formats import import_format
from rcs_data.convert.labels import row_texts
from rcs_data.convert.options import ExportOptions, ImportOptions
from rcs_data.convert.rlds.export import export_rlds
from rcs_data.convert.rlds.import_ import import_rlds, is_rlds
from rcs_data.convert.rlds.tfrecord import ShardWriter
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.files.codec import encode_png

STEPS = 4
IMAGE = np.add.outer(np.arange(16) * 4, np.arange(24) * 3)[..., None].astype(np.uint8) + np.zeros(3, np.uint8)
JPEG = simplejpeg.encode_jpeg(IMAGE, 90)
DEPTH = np.arange(48, dtype=np.uint16).reshape(6, 8) * 1000


def test_an_export_of_ours_comes_back_with_its_names_and_its_jpegs(dataset: Path, tmp_path: Path) -> None:
    source = Dataset.open(dataset)
    export_rlds(source, tmp_path / "out", ExportOptions(extra=("action/index",)))
    assert is_rlds(tmp_path / "out")
    back = import_rlds(tmp_path / "out", tmp_path / "back")
    known = {feature.key: feature for feature in source.info.features}
    assert {feature.key: feature for feature in back.info.features} == {
        key: known[key] for key in known if not key.startswith("time/")
    }
    assert (back.info.frequency, back.info.setup) == (source.info.frequency, source.info.setup)
    for old, new in zip(source.episodes, back.episodes, strict=True):
        assert (new.id, new.seed, new.success, new.length) == (old.id, old.seed, old.success, old.length)
        assert new.outcome["failure"] == old.outcome["failure"]
        assert new.outcome["imported"]["provenance"]["content_hash"] == old.content_hash
        key = "observation/frames/wrist/rgb"
        assert list(new.encoded_frames(key))[:-1] == list(old.encoded_frames(key))[:-1]
        key = "observation/frames/wrist/depth"
        np.testing.assert_array_equal(new.column(key)[:-1], old.column(key)[:-1])
        for key in ("observation/joints", "action/joints", "action/index", "reward", "terminated"):
            rows = slice(1, None) if not key.startswith("obs") else slice(None, -1)
            expected = old.column(key)[rows]
            expected = expected.astype(np.float32) if expected.dtype == np.float64 else expected
            np.testing.assert_array_equal(new.column(key)[rows], expected, err_msg=key)
        np.testing.assert_array_equal(new.column("observation/joints")[-1], new.column("observation/joints")[-2])
    assert check(tmp_path / "back").is_ok


@pytest.mark.parametrize("more", [(), ("observation/environment_state",)])
def test_an_export_without_reward_and_with_a_state_of_its_own_comes_back(tmp_path: Path, more: tuple[str, ...]) -> None:
    keys = ("observation/state", *more, "action/gripper", "action/joints")
    features = tuple(Feature(key=key, shape=(2,), dtype="float32") for key in keys)
    info = DatasetInfo(frequency=10, features=features, setup={"a": 1}, instruction="pick")
    with DatasetWriter.open(tmp_path / "in", info) as writer, writer.episode("a", seed=None) as episode:
        for row in range(4):
            values = {key: np.array([row, 10 * i], np.float32) for i, key in enumerate(keys)}
            episode.add({key: value for key, value in values.items() if row or key.startswith("obs")})
        episode.finish(None)
    source = Dataset.open(tmp_path / "in")
    export_rlds(source, tmp_path / "out")
    back = import_rlds(tmp_path / "out", tmp_path / "back")
    assert back.info == source.info
    for key in keys:
        rows = slice(None, -1) if key.startswith("obs") else slice(1, None)
        np.testing.assert_array_equal(back["a"].column(key)[rows], source["a"].column(key)[rows])


def test_a_dataset_of_others_becomes_one_of_ours(tmp_path: Path) -> None:
    _foreign(tmp_path / "in")
    assert import_format("auto", tmp_path / "in") is import_rlds
    back = import_rlds(tmp_path / "in", tmp_path / "back", ImportOptions(frequency=5))
    forms = {feature.key: (feature.shape, feature.dtype, feature.encoding) for feature in back.info.features}
    assert forms == {
        "observation/frames/image_0/rgb": ((16, 24, 3), "uint8", "jpeg"),
        "observation/frames/depth/depth": ((6, 8), "uint16", "depth"),
        "observation/state": ((2,), "float32", "plain"),
        "imported/language_embedding": ((3,), "float32", "plain"),
        "action/action": ((2,), "float32", "plain"),
        "reward": ((), "float32", "plain"),
        "truncated": ((), "bool", "plain"),
        "terminated": ((), "bool", "plain"),
        "imported/language_instruction": ((), "int32", "plain"),
    }
    assert set(back.info.setup["imported"]["left_out"]) == {"observation/points"}
    (first, second) = back.episodes
    assert (first.length, first.instruction, second.instruction) == (STEPS + 1, "push", "push")
    np.testing.assert_array_equal(first.column("observation/state")[:, 0], [0, 1, 2, 3, 3])
    np.testing.assert_array_equal(first.column("action/action")[1:, 1], [10, 11, 12, 13])
    assert first.column("terminated").tolist() == [False] * STEPS + [True] and not first.column("truncated").any()
    assert second.column("truncated").tolist() == [False] * STEPS + [True] and not second.column("terminated").any()
    assert set(first.encoded_frames("observation/frames/image_0/rgb")) == {JPEG}
    np.testing.assert_array_equal(first.column("observation/frames/depth/depth")[2], DEPTH)
    words = ["push", "push", "pull", "pull", "pull"]  # the last row repeats
    assert row_texts(second, "imported/language_instruction") == words
    assert len(Windows(back, horizon=2)) == 2 * STEPS
    assert check(tmp_path / "back").is_ok


def test_the_rate_must_be_given(tmp_path: Path) -> None:
    _foreign(tmp_path / "in")
    with pytest.raises(InvalidSetup, match="give frequency"):
        import_rlds(tmp_path / "in", tmp_path / "back")
    assert not (tmp_path / "back").exists()


def test_files_that_were_not_downloaded_are_refused_unless_they_may_be_missing(tmp_path: Path) -> None:
    _foreign(tmp_path / "in", shard_bytes=1)
    (first, second) = sorted(tmp_path.glob("in/x/1.0.0/*tfrecord*"))
    first.unlink()
    with pytest.raises(InvalidSetup, match="1 of the 2 files"):
        import_rlds(tmp_path / "in", tmp_path / "back", ImportOptions(frequency=5))
    notes: list[str] = []
    options = ImportOptions(frequency=5, allow_missing=True, on_note=notes.append)
    assert [e.id for e in import_rlds(tmp_path / "in", tmp_path / "back", options)] == ["000001"]
    assert len(notes) == 1 and first.name in notes[0]
    chosen = ImportOptions(frequency=5, episodes=("1",), cameras=())
    back = import_rlds(tmp_path / "in", tmp_path / "back2", chosen)
    assert [e.id for e in back] == ["000001"] and not [f.key for f in back.info.features if f.is_image]
    second.unlink()
    with pytest.raises(InvalidSetup, match="0 of the 2 files"):
        import_rlds(tmp_path / "in", tmp_path / "back3", options)


def test_damaged_episodes_are_left_out_and_named_if_that_is_allowed(tmp_path: Path) -> None:
    _foreign(tmp_path / "in", changes={"steps/observation/image_0": [JPEG, b"words", JPEG, JPEG]})
    notes: list[str] = []
    options = ImportOptions(frequency=5, allow_missing=True, on_note=notes.append)
    back = import_rlds(tmp_path / "in", tmp_path / "back", options)
    assert [e.id for e in back] == ["000000"] and "Episode 1 was left out" in notes[0]
    assert check(tmp_path / "back").is_ok


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("steps/observation/image_0", [b"words"] * STEPS, "not an image"),
        ("steps/observation/image_0", [JPEG[:-300]] * STEPS, "not a whole JPEG"),
        ("steps/observation/image_0", [encode_png(IMAGE)[:-30]] * STEPS, "not a whole PNG"),
        ("steps/observation/image_0", [encode_png(np.zeros((9, 9, 3), np.uint8))] * STEPS, r"expected \(16, 24, 3\)"),
        ("steps/observation/image_0", [JPEG] * (STEPS - 1), "fewer values"),
        ("steps/observation/image_0", np.zeros(STEPS, np.float32), "lacks the byte strings"),
        ("steps/action", [b"words"], "lacks the numbers"),
        ("steps/action", np.zeros(7, np.float32), "no multiple of the 2"),
        ("steps/action", np.zeros(6, np.float32), "expected equal numbers"),
        ("steps/reward", np.zeros(0, np.float32), "expected equal numbers"),
        ("steps/is_terminal", None, "lacks the numbers .steps/is_terminal."),
    ],
)
def test_episodes_that_are_not_as_described_are_refused(tmp_path: Path, name: str, values: Any, message: str) -> None:
    _foreign(tmp_path / "in", changes={name: values})
    with pytest.raises(CorruptEpisode, match=message):
        import_rlds(tmp_path / "in", tmp_path / "back", ImportOptions(frequency=5))
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


@pytest.mark.parametrize(
    ("file", "text", "error", "message"),
    [
        ("features.json", "[" * 10_000, CorruptEpisode, "damaged"),
        ("features.json", "{}", CorruptEpisode, "does not describe features"),
        ("features.json", '{"pythonClassName": "x.Dataset", "featuresDict": {"features": 3}}', CorruptEpisode, "does"),
        ("dataset_info.json", '{"fileFormat": "riegeli"}', InvalidSetup, "only tfrecord"),
        ("dataset_info.json", "{}", CorruptEpisode, "damaged"),
        (
            "dataset_info.json",
            '{"name": "../x", "splits": [{"name": "train", "shardLengths": ["1"]}]}',
            CorruptEpisode,
            "cannot have 1 episodes",
        ),
        ("rcs.json", "{}", CorruptEpisode, "damaged"),
        ("rcs.json", '{"info": {"features": []}, "columns": 3, "action": []}', Exception, "version|damaged"),
    ],
)
def test_descriptions_that_are_damaged_are_refused(
    tmp_path: Path, file: str, text: str, error: type[Exception], message: str
) -> None:
    _foreign(tmp_path / "in")
    (tmp_path / "in/x/1.0.0" / file).write_text(text)
    with pytest.raises(error, match=message):
        import_rlds(tmp_path / "in", tmp_path / "back", ImportOptions(frequency=5))
    assert not (tmp_path / "back").exists()


@pytest.mark.parametrize("shape", [["1000000000", "1000000000"], ["0"], ["-1", "3"]])
def test_a_shape_that_cannot_be_leaves_the_column_out(tmp_path: Path, shape: list[str]) -> None:
    _foreign(tmp_path / "in")
    path = tmp_path / "in/x/1.0.0/features.json"
    values = json.loads(path.read_text())
    steps = values["featuresDict"]["features"]["steps"]["sequence"]["feature"]["featuresDict"]["features"]
    steps["language_embedding"]["tensor"]["shape"]["dimensions"] = shape
    path.write_text(json.dumps(values))
    back = import_rlds(tmp_path / "in", tmp_path / "back", ImportOptions(frequency=5))
    assert "language_embedding" in back.info.setup["imported"]["left_out"]


def test_a_folder_without_a_dataset_is_refused(tmp_path: Path) -> None:
    assert not is_rlds(tmp_path) and not is_rlds(tmp_path / "none")
    with pytest.raises(InvalidSetup, match="no single folder"):
        import_rlds(tmp_path, tmp_path / "back")


def _foreign(folder: Path, *, shard_bytes: int = 10**9, changes: dict[str, Any] | None = None) -> None:
    """Write a dataset as TensorFlow Datasets does: two episodes of four steps."""
    folder = folder / "x/1.0.0"
    folder.mkdir(parents=True)
    shards = ShardWriter(folder, "x-train.tfrecord", shard_bytes)
    for index in range(2):
        rows = np.arange(STEPS, dtype=np.float32)
        last = np.arange(STEPS) == STEPS - 1
        values: dict[str, Any] = {
            "episode_metadata/file_path": [b"/data"],
            "steps/observation/image_0": [JPEG] * STEPS,
            "steps/observation/depth": [encode_png(DEPTH)] * STEPS,
            "steps/observation/state": np.stack([rows, rows], 1),
            "steps/observation/points/ragged_flat_values": rows,
            "steps/language_embedding": np.zeros((STEPS, 3), np.float32),
            "steps/action": np.stack([rows, rows + 10], 1),
            "steps/reward": rows,
            "steps/is_first": (rows == 0).astype(np.int64),
            "steps/is_last": last.astype(np.int64),
            "steps/is_terminal": (last & (index == 0)).astype(np.int64),
            "steps/language_instruction": [b"push", b"push"] + [b"pull" if index else b"push"] * 2,
        }
        values |= (changes or {}) if index else {}
        shards.write({name: given for name, given in values.items() if given is not None})
    shards.close()

    def numbers(*shape: int, dtype: str = "float32") -> dict[str, Any]:
        dimensions = {"dimensions": [str(n) for n in shape]} if shape else {}
        return {
            "pythonClassName": "tensorflow_datasets.core.features.tensor_feature.Tensor",
            "tensor": {"shape": dimensions, "dtype": dtype, "encoding": "none"},
        }

    def image(shape: tuple[str, ...], **about: str) -> dict[str, Any]:
        where = "tensorflow_datasets.core.features.image_feature.Image"
        return {"pythonClassName": where, "image": {"shape": {"dimensions": list(shape)}, **about}}

    def group(**inner: Any) -> dict[str, Any]:
        return {"pythonClassName": "a.FeaturesDict", "featuresDict": {"features": inner}}

    steps = group(
        observation=group(
            image_0=image(("-1", "-1", "3"), encodingFormat="jpeg"),
            depth=image(("6", "8", "1"), dtype="uint16", encodingFormat="png"),
            state=numbers(2),
            points={"pythonClassName": "a.Sequence", "sequence": {"feature": numbers(), "length": "-1"}},
        ),
        language_embedding=numbers(3),
        action=numbers(2),
        reward=numbers(),
        is_first=numbers(dtype="bool"),
        is_last=numbers(dtype="bool"),
        is_terminal=numbers(dtype="bool"),
        language_instruction={"pythonClassName": "a.Text", "text": {}},
    )
    whole = group(
        steps={"pythonClassName": "a.Dataset", "sequence": {"feature": steps, "length": "-1"}},
        episode_metadata=group(file_path={"pythonClassName": "a.Text", "text": {}}),
    )
    (folder / "features.json").write_text(json.dumps(whole))
    split = {"name": "train", "shardLengths": [str(n) for n in shards.shard_lengths]}
    (folder / "dataset_info.json").write_text(json.dumps({"name": "x", "fileFormat": "tfrecord", "splits": [split]}))
