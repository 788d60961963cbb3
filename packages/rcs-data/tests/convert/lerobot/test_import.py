"""Exports come back; datasets that others made come in; damaged ones are refused."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, JointBounds, check, edit
from rcs_data.convert.formats import IMPORTS, export_format, import_format
from rcs_data.convert.lerobot import source as lerobot_source
from rcs_data.convert.lerobot.export import export_lerobot
from rcs_data.convert.lerobot.import_ import import_lerobot
from rcs_data.convert.options import ExportOptions, ImportOptions
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup, UnknownName
from rcs_data.read.trajectory import camera_features

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
    assert back.info.features == tuple(f for f in source.info.features if f.encoding != "depth")
    assert back.info.frequency == source.info.frequency
    assert back.info.instruction == source.info.instruction
    assert back.info.setup["imported"]["setup"] == source.info.setup
    for feature in back.info.features:
        compared(source, back, feature)
    for old, new in zip(source.episodes, back.episodes, strict=True):
        assert (old.id, old.seed, old.success, old.instruction) == (new.id, new.seed, new.success, new.instruction)
        assert {**old.outcome, "imported": new.outcome["imported"]} == new.outcome
        assert new.outcome["imported"]["last_observation"] == "repeated"
    assert check(tmp_path / "back").is_ok


@pytest.mark.parametrize("name", ["lerobot-v3", "rlds"])
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
    export_format(name)(Dataset.open(tmp_path / "source"), tmp_path / "out", ExportOptions(extra=(action, flags)))
    back = import_format("auto", tmp_path / "out")(tmp_path / "out", tmp_path / "back", ImportOptions())
    np.testing.assert_array_equal(back.episodes[0].column(action)[:, 0], [0, 1, 2, 3, 4])
    # The last image repeats the one before, unless the format has it.
    repeated = back.episodes[0].outcome["imported"].get("repeated", ())
    assert back.episodes[0].column(flags).tolist() == [0, 0, 0, 0, int(flags in repeated)]
    assert check(tmp_path / "back").is_ok


@pytest.mark.parametrize("name", ["lerobot-v3", "lerobot-v2.1", "gr00t", "rlds", "robomimic"])
def test_a_simulation_that_computes_unevenly_has_no_gap_after_a_round_trip(tmp_path: Path, name: str) -> None:
    keys = ("time/monotonic", "simulated_time")
    limits = JointBounds(arm="an arm of tests", names=("a", "b"), lower=(-1, -1), upper=(1, 1), velocity=(2, 2))
    features = [Feature(key=key, shape=(), dtype="float64", unit="s") for key in keys]
    features.append(Feature(key="observation/joints", shape=(2,), dtype="float32", limits=limits))
    features.append(Feature(key="observation/frames/side/rgb", shape=(32, 48, 3), dtype="uint8", encoding="jpeg"))
    features.append(Feature(key="action/joints", shape=(2,), dtype="float32"))
    info = DatasetInfo(frequency=30.0, features=tuple(features), setup={}, instruction="wave")
    with DatasetWriter.open(tmp_path / "source", info) as writer, writer.episode("take", seed=None) as episode:
        for i in range(20):
            values = {"observation/joints": np.full(2, i / 50, "f4"), "time/monotonic": i / 40 + i // 10}
            values |= {"action/joints": np.full(2, i / 50, "f4")} if i else {}
            values |= {"observation/frames/side/rgb": np.full((32, 48, 3), 40 + 8 * i, np.uint8)}
            episode.add({**values, "simulated_time": i / 30})
        episode.finish(True)
    assert not check(tmp_path / "source").findings
    export_format(name)(Dataset.open(tmp_path / "source"), tmp_path / "out", ExportOptions())
    back = import_format("auto", tmp_path / "out")(tmp_path / "out", tmp_path / "back", ImportOptions())
    assert not check(tmp_path / "back").findings, str(check(tmp_path / "back"))
    if name != "robomimic":  # which has no limits of joints
        assert back.info.feature("observation/joints").limits == limits
    if name not in ("rlds", "robomimic"):  # which have no times
        times = back.episodes[0].column("simulated_time")
        np.testing.assert_array_equal(times[:-1], np.arange(19) / 30)
        assert np.isnan(times[-1]), "LeRobot has no time for the last observation"


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


@pytest.mark.parametrize("name", ["run:1", "12:30"])
def test_a_folder_that_is_named_like_an_address_is_imported(
    source: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    export_lerobot(source, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    assert len(import_lerobot(name, "back")) == len(source)


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


def test_an_export_that_was_changed_since_is_not_trusted(make_dataset: Any, tmp_path: Path) -> None:
    export_lerobot(make_dataset("source"), tmp_path / "given")
    path = tmp_path / "given" / "meta" / "rcs_provenance.jsonl"
    path.write_text("\n".join(path.read_text().split("\n")[1:]))
    back = import_lerobot(tmp_path / "given", tmp_path / "back")
    assert back.episodes[0].outcome["imported"]["last_observation"] == "repeated"
    assert back.episodes[0].seed is None


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
        (gone, "Cannot read"),
        (video, "no frame at"),
        (garbage, "damaged"),
    ):
        with pytest.raises(CorruptEpisode, match=words):
            import_lerobot(folder, tmp_path / "out")
        assert not (tmp_path / "out").exists()


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


def test_what_the_actions_of_our_exports_count_from_is_kept(make_dataset: Any, tmp_path: Path) -> None:
    meaning = {"control": "joints", "relative": "last_step"}
    export_lerobot(make_dataset(cameras=False, setup={"robot": "fr3", **meaning}), tmp_path / "lerobot")
    back = import_lerobot(tmp_path / "lerobot", tmp_path / "back")
    assert {key: back.info.setup[key] for key in back.info.setup if key != "imported"} == meaning
    before = [episode.column("action/joints")[1:] for episode in back]
    edit.resample(tmp_path / "back", 10)
    for steps, episode in zip(before, Dataset.open(tmp_path / "back"), strict=True):
        after = episode.column("action/joints")[1:]
        np.testing.assert_allclose(after.sum(axis=0), steps.sum(axis=0))
        np.testing.assert_allclose(after[0], steps[:3].sum(axis=0))


def test_an_import_opens_each_file_a_fixed_number_of_times(
    make_dataset: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else it is quadratic: each time, the footer is read, which grows with the number of episodes."""
    counts, opened = list[int](), lerobot_source._opened
    for episodes in (3, 12):
        export_lerobot(make_dataset(f"of-{episodes}", cameras=False, episodes=episodes), tmp_path / f"l-{episodes}")
        files: list[Path] = []

        def watched(path: Path, files: list[Path] = files) -> Any:
            files.append(path)
            return opened(path)

        monkeypatch.setattr(lerobot_source, "_opened", watched)
        import_lerobot(tmp_path / f"l-{episodes}", tmp_path / f"b-{episodes}")
        counts.append(len(files))
    assert counts[0] == counts[1]


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
    assert import_format("auto", tmp_path / "lerobot") is IMPORTS["lerobot"][1]
    with pytest.raises(UnknownName, match="lerobot-v3"):
        export_format("lerobot-v4")
    with pytest.raises(UnknownName, match="auto"):
        import_format("zarr", tmp_path)
    with pytest.raises(InvalidSetup, match="Cannot recognise"):
        import_format("auto", dataset.path)
