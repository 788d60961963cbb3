"""What was exported comes back; what others made comes in; what is damaged is refused."""

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
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, Windows, check
from rcs_data.codec import encode_jpeg
from rcs_data.convert import lerobot_source
from rcs_data.convert.formats import IMPORTS, export_format, import_format
from rcs_data.convert.labels import row_texts
from rcs_data.convert.lerobot import export_lerobot
from rcs_data.convert.lerobot_import import import_lerobot
from rcs_data.convert.lerobot_source import LeRobotSource
from rcs_data.convert.options import ExportOptions, ImportOptions
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup, UnknownName
from rcs_data.parquet import opened_of_others
from rcs_data.trajectory import action_layout, camera_features, state_layout

WORDS = ("pick up the green cuboid", "nimm den grünen Würfel – 拿起方块")
# Everything that the default options leave out.
EXTRA = ("observation/xyzrpy", "executed/joints")
SINGLE = {"observation/joints", "action/joints", "reward"}


def compared(before: Dataset, after: Dataset, feature: Feature) -> None:
    """Fail unless a feature is the same in all episodes, at the precision that the format has."""
    for old, new in zip(before.episodes, after.episodes, strict=True):
        # LeRobot has no frame for the last observation.
        rows = slice(None) if feature.is_unknown_at_reset or feature.key == "terminated" else slice(-1)
        a, b = old.column(feature.key)[rows], new.column(feature.key)[rows]
        assert (a.shape, a.dtype) == (b.shape, b.dtype), feature.key
        if feature.encoding == "jpeg":
            assert np.abs(a.astype(float) - b).mean() < 4
            np.testing.assert_allclose(a.mean(axis=(0, 1, 2)), b.mean(axis=(0, 1, 2)), atol=2.5)
        elif feature.key in SINGLE:
            np.testing.assert_array_equal(a.astype(np.float32), b.astype(np.float32), err_msg=feature.key)
        else:
            np.testing.assert_array_equal(a, b, err_msg=feature.key)


@pytest.mark.parametrize("version", ["3.0", "2.1"])
def test_export_and_import_give_everything_back(source: Dataset, tmp_path: Path, version: Any) -> None:
    export_lerobot(source, tmp_path / "lerobot", ExportOptions(extra=EXTRA), version=version)
    back = import_lerobot(tmp_path / "lerobot", tmp_path / "back")
    assert back.info.features == source.info.features
    assert back.info.frequency == source.info.frequency
    assert back.info.instruction == source.info.instruction
    assert back.info.setup["imported"]["setup"] == source.info.setup
    for feature in source.info.features:
        compared(source, back, feature)
    for old, new in zip(source.episodes, back.episodes, strict=True):
        assert (old.id, old.seed, old.success, old.instruction) == (new.id, new.seed, new.success, new.instruction)
        assert {**old.outcome, "imported": new.outcome["imported"]} == new.outcome
        assert new.outcome["imported"]["last_observation"] == "repeated"
    assert check(tmp_path / "back").is_ok


@pytest.mark.parametrize("name", ["lerobot-v3", "rlds", "robomimic"])
def test_other_forms_of_the_action_and_flags_stay_with_their_rows(tmp_path: Path, name: str) -> None:
    action, flags = "action_dict/absolute", "flags/frames/side"
    features = (
        Feature(key="observation/joints", shape=(2,), dtype="float32"),
        Feature(key="observation/frames/side/rgb", shape=(16, 16, 3), dtype="uint8", encoding="jpeg"),
        Feature(key="action/joints", shape=(2,), dtype="float32"),
        Feature(key=action, shape=(2,), dtype="float32"),
        Feature(key=flags, shape=(), dtype="uint8"),
    )
    info = DatasetInfo(frequency=30.0, features=features, setup={}, instruction="")
    with DatasetWriter.open(tmp_path / "source", info) as writer, writer.episode("take", seed=None) as episode:
        for i in range(5):
            values = {f.key: np.full(f.shape, i, f.dtype)[()] for f in features}
            values |= {"action/joints": None} if not i else {}
            episode.add({**values, flags: np.uint8(0)})
        episode.finish(None)
    options = ExportOptions(extra=() if name == "robomimic" else (action, flags))  # robomimic's files have all
    export_format(name)(Dataset.open(tmp_path / "source"), tmp_path / "out", options)
    back = import_format("auto", tmp_path / "out")(tmp_path / "out", tmp_path / "back", ImportOptions())
    np.testing.assert_array_equal(back.episodes[0].column(action)[:, 0], [0, 1, 2, 3, 4])
    # The last image repeats the one before, unless the format has it.
    repeated = back.episodes[0].outcome["imported"].get("repeated", ())
    assert back.episodes[0].column(flags).tolist() == [0, 0, 0, 0, int(flags in repeated)]
    assert check(tmp_path / "back").is_ok


@pytest.mark.parametrize("name", ["lerobot-v3", "lerobot-v2.1", "gr00t", "rlds", "robomimic"])
def test_a_simulation_that_computes_unevenly_has_no_gap_after_a_round_trip(tmp_path: Path, name: str) -> None:
    keys = ("time/monotonic", "simulated_time")
    features = [Feature(key=key, shape=(), dtype="float64", unit="s") for key in keys]
    features += [Feature(key=f"{part}/joints", shape=(2,), dtype="float32") for part in ("observation", "action")]
    info = DatasetInfo(frequency=30.0, features=tuple(features), setup={}, instruction="wave")
    with DatasetWriter.open(tmp_path / "source", info) as writer, writer.episode("take", seed=None) as episode:
        for i in range(20):
            values = {"observation/joints": np.full(2, i / 50, "f4"), "time/monotonic": i / 40 + i // 10}
            values |= {"action/joints": np.full(2, i / 50, "f4")} if i else {}
            episode.add({**values, "simulated_time": i / 30})
        episode.finish(True)
    assert not check(tmp_path / "source").findings
    export_format(name)(Dataset.open(tmp_path / "source"), tmp_path / "out", ExportOptions())
    back = import_format("auto", tmp_path / "out")(tmp_path / "out", tmp_path / "back", ImportOptions())
    assert not check(tmp_path / "back").findings, str(check(tmp_path / "back"))
    if name != "rlds":  # which has no times
        times = back.episodes[0].column("simulated_time")
        np.testing.assert_array_equal(times[:-1], np.arange(19) / 30)
        assert name == "robomimic" or np.isnan(times[-1]), "LeRobot has no time for the last observation"


def test_two_robots_and_no_cameras_come_back(make_dataset: Any, tmp_path: Path) -> None:
    before = make_dataset(cameras=False, robots=("left", "right"), success=(None,))
    export_lerobot(before, tmp_path / "lerobot")
    back = import_lerobot(tmp_path / "lerobot", tmp_path / "back")
    for side in ("left", "right"):
        for part in ("observation", "action"):
            key = f"{part}/{side}/joints"
            for old, new in zip(before.episodes, back.episodes, strict=True):
                np.testing.assert_array_equal(
                    old.column(key)[1:-1].astype(np.float32), new.column(key)[1:-1].astype(np.float32)
                )
    assert [episode.success for episode in back.episodes] == [None, None, None]


def test_images_can_stay_without_more_loss(source: Dataset, tmp_path: Path) -> None:
    export_lerobot(source, tmp_path / "lerobot")
    back = import_lerobot(tmp_path / "lerobot", tmp_path / "back", ImportOptions(lossless=True))
    assert back.info.feature("observation/frames/side/rgb").encoding == "lossless"


def test_a_second_round_changes_no_number(source: Dataset, tmp_path: Path) -> None:
    first = tmp_path / "first"
    export_lerobot(source, first)
    import_lerobot(first, tmp_path / "back")
    export_lerobot(Dataset.open(tmp_path / "back"), tmp_path / "second")
    tables = [pq.read_table(tmp_path / n / "data" / "chunk-000" / "file-000.parquet") for n in ("first", "second")]
    for name in tables[0].column_names:
        left, right = (np.array(table.column(name).to_pylist()) for table in tables)
        np.testing.assert_array_equal(left, right, err_msg=name)


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


def test_an_export_that_was_changed_since_is_not_trusted(make_dataset: Any, tmp_path: Path) -> None:
    for name, cameras in (("plain", False), ("seen", True)):
        given = tmp_path / name
        export_lerobot(make_dataset(f"of-{name}", cameras=cameras), given)
        path = given / "meta" / "rcs_provenance.jsonl"
        path.write_text("\n".join(path.read_text().split("\n")[1:]))
    back = import_lerobot(tmp_path / "plain", tmp_path / "back")
    assert back.episodes[0].outcome["imported"]["last_observation"] == "repeated"
    assert back.episodes[0].seed is None
    with pytest.raises(CorruptEpisode, match="changed since"):
        import_lerobot(tmp_path / "seen", tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_missing_rows_frames_and_files_are_told(source: Dataset, tmp_path: Path) -> None:
    good = tmp_path / "good"
    export_lerobot(source, good, version="2.1")

    def broken(name: str) -> Path:
        return Path(shutil.copytree(good, tmp_path / name))

    rows = broken("rows")
    path = rows / "data" / "chunk-000" / "episode_000001.parquet"
    pq.write_table(pq.read_table(path).slice(0, 4), path)
    gone = broken("gone")
    (gone / "data" / "chunk-000" / "episode_000002.parquet").unlink()
    video = broken("video")
    shutil.copy(
        video / "videos" / "chunk-000" / "observation.images.side" / "episode_000000.mp4",
        video / "videos" / "chunk-000" / "observation.images.side" / "episode_000002.mp4",
    )
    garbage = broken("garbage")
    (garbage / "meta" / "info.json").write_text("{")
    for folder, words in (
        (rows, "4 rows"),
        (gone, "missing or not a file"),
        (video, "no frame at"),
        (garbage, "damaged"),
    ):
        with pytest.raises(CorruptEpisode, match=words):
            import_lerobot(folder, tmp_path / "out")
        assert not (tmp_path / "out").exists()


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


@pytest.mark.parametrize("version", ["3.0", "2.1"])
def test_a_part_is_imported_and_nothing_else_is_needed(source: Dataset, tmp_path: Path, version: Any) -> None:
    export_lerobot(source, tmp_path / "lerobot", version=version)
    for path in (tmp_path / "lerobot").glob("**/observation.images.wrist/**/*.mp4"):
        path.unlink()
    options = ImportOptions(episodes=("1-",), cameras=("side",))
    back = import_lerobot(tmp_path / "lerobot", tmp_path / "back", options)
    assert [episode.id for episode in back.episodes] == ["take-1", "take-2"]
    assert list(camera_features(back.info)) == ["side"]
    compared_frames = back.episodes[0].column("observation/frames/side/rgb")[:-1].astype(float)
    truth = source.episodes[1].column("observation/frames/side/rgb")[:-1]
    assert np.abs(compared_frames - truth).mean() < 4
    for wrong, words in (
        ({"episodes": ("7",)}, "names no episode"),
        ({"cameras": ("top",)}, "no camera of this dataset named 'top'"),
    ):
        with pytest.raises(InvalidSetup, match=words):
            import_lerobot(tmp_path / "lerobot", tmp_path / "other", ImportOptions(**wrong))


def test_what_is_missing_is_left_out_and_named_where_allowed(source: Dataset, tmp_path: Path) -> None:
    given = tmp_path / "lerobot"
    export_lerobot(source, given, version="2.1")
    (given / "videos/chunk-000/observation.images.side/episode_000000.mp4").unlink()
    (given / "data/chunk-000/episode_000002.parquet").write_bytes(b"PAR1")
    with pytest.raises(CorruptEpisode, match="episode_000002"):
        import_lerobot(given, tmp_path / "back")
    told: list[str] = []
    back = import_lerobot(given, tmp_path / "back", ImportOptions(allow_missing=True, on_note=told.append))
    assert [episode.id for episode in back.episodes] == ["take-1"]
    assert check(tmp_path / "back").is_ok
    assert sorted(text[:9] for text in told) == ["Episode 0", "Episode 2"]
    (given / "videos/chunk-000/observation.images.side/episode_000001.mp4").unlink()
    with pytest.raises(CorruptEpisode, match="No episode"):
        import_lerobot(given, tmp_path / "none", ImportOptions(allow_missing=True))
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("name", ["meta/info.json", "data/chunk-000/file-000.parquet", "meta/tasks.parquet",
    "meta/episodes/chunk-000/file-000.parquet", "videos/observation.images.side/chunk-000/file-000.mp4"])  # fmt: skip
def test_a_pointer_of_git_lfs_is_named_with_the_remedy(source: Dataset, tmp_path: Path, name: str) -> None:
    export_lerobot(source, tmp_path / "lerobot")
    (tmp_path / "lerobot" / name).write_text(
        "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab\nsize 12345\n"
    )
    with pytest.raises(CorruptEpisode, match=r"Git LFS pointer.*`git lfs pull`"):
        import_lerobot(tmp_path / "lerobot", tmp_path / "back")


def test_an_import_opens_each_file_a_fixed_number_of_times(
    make_dataset: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else it is quadratic: each time, the footer is read, which grows with the number of episodes."""
    counts: list[int] = []
    for episodes in (3, 12):
        export_lerobot(make_dataset(f"of-{episodes}", cameras=False, episodes=episodes), tmp_path / f"l-{episodes}")
        opened: list[Path] = []

        def watched(path: Path, opened: list[Path] = opened) -> Any:
            opened.append(path)
            return opened_of_others(path)

        monkeypatch.setattr(lerobot_source, "opened_of_others", watched)
        import_lerobot(tmp_path / f"l-{episodes}", tmp_path / f"b-{episodes}")
        counts.append(len(opened))
    assert counts[0] == counts[1]


def test_jpeg_files_in_tables_stay_as_they_are(make_dataset: Any, tmp_path: Path) -> None:
    given = foreign(make_dataset(cameras=False), tmp_path / "lerobot", "2.1")
    described(given, image={"dtype": "image", "shape": [8, 16, 3], "names": ["height", "width", "channel"]})
    jpeg = encode_jpeg(np.random.default_rng(0).integers(0, 256, (8, 16, 3), np.uint8), 80, "420")
    changed(given, lambda t: t.append_column("image", pa.array([{"bytes": jpeg, "path": "x.jpg"}] * len(t))))
    back = import_lerobot(given, tmp_path / "back")
    assert set(back.episodes[0].encoded_frames("observation/frames/image/rgb")) == {jpeg}


def test_versions_that_are_not_known_are_refused(make_dataset: Any, tmp_path: Path) -> None:
    export_lerobot(make_dataset(cameras=False), tmp_path / "lerobot")
    info = tmp_path / "lerobot" / "meta" / "info.json"
    info.write_text(info.read_text().replace("v3.0", "v1.6"))
    with pytest.raises(DatasetError, match=r"v1\.6; supported: v2\.0"):
        import_lerobot(tmp_path / "lerobot", tmp_path / "out")
    with pytest.raises(DatasetError, match=r"info\.json is missing"):
        import_lerobot(tmp_path, tmp_path / "out")


def test_formats_are_found_by_name_and_by_looks(make_dataset: Any, tmp_path: Path) -> None:
    dataset = make_dataset(cameras=False)
    export_format("lerobot-v2.1")(dataset, tmp_path / "lerobot", ExportOptions())
    assert import_format("auto", tmp_path / "lerobot") is IMPORTS["lerobot"].read
    with pytest.raises(UnknownName, match="lerobot-v3"):
        export_format("lerobot-v4")
    with pytest.raises(UnknownName, match="auto"):
        import_format("zarr", tmp_path)
    with pytest.raises(InvalidSetup, match="Cannot recognise"):
        import_format("auto", dataset.path)
