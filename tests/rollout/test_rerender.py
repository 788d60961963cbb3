"""Rendering recorded states again: only frames change, and without options not even they."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, EpisodeRecord

import rcs
from rcs.cli.setup_options import changed
from rcs.errors import DatasetError, InvalidSetup
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.recorded_setup import physics_of, setup_of
from rcs.rollout.replay import replay
from rcs.rollout.rerender import is_of_camera, rerender

pytestmark = pytest.mark.gl

SIZE = 48


def recorded(out: Path, *, colour: Any = "jpeg", **options: Any) -> Path:
    usual: dict[str, Any] = {"names": ("wrist", "side"), "image_size": SIZE}
    usual |= {name: options.pop(name) for name in ("depth", "noise", "fps") if name in options}
    if "cameras" in options:
        usual["names"] = options.pop("cameras")
    setup = rcs.Setup(cameras=rcs.Cameras(**usual), **{"max_episode_steps": 40, **options})
    for _ in collect(Collection(setup=setup, out=out, episodes=2, seed=1, colour=colour), Progress()):
        pass
    return out


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("rerender") / "dataset")


def run(source: Path, out: Path, workers: int = 1, looks_seed: int | None = None, **options: Any) -> Dataset:
    setup = changed(setup_of(Dataset.open(source)), options) if options else None
    list(rerender(source, out, setup=setup, looks_seed=looks_seed, workers=workers))
    return Dataset.open(out)


def assert_equal_but_for_frames(old: EpisodeRecord, new: EpisodeRecord) -> None:
    cameras = ["wrist", "side", "front"]
    keys = [[f.key for f in e.info.features if not is_of_camera(f.key, cameras)] for e in (old, new)]
    assert keys[0] == keys[1]
    for key in keys[0]:
        if not old.info.feature(key).is_circumstance or key in ("time/monotonic", "time/period"):
            assert old.column(key).tobytes() == new.column(key).tobytes(), key
    assert old.sim_state().tobytes() == new.sim_state().tobytes()
    assert (old.seed, old.success, old.instruction) == (new.seed, new.success, new.instruction)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"depth": True, "noise": True},
        {"fps": 15.0},
        {"colour": "lossless"},
        {"randomisation": True},
        {"render_quality": "full", "cameras": ("side",), "max_episode_steps": 2},
        {"task": "LiftBar", "robot": "dual_fr3", "cameras": ("front",)},
        {"task": "PickToy", "robot": "xarm7", "cameras": ("front",), "max_episode_steps": 10},
    ],
    ids=["plain", "noise", "slow cameras", "lossless", "randomised", "full", "two arms", "soft"],
)
def test_with_nothing_changed_every_frame_has_the_same_bits(tmp_path: Path, options: dict[str, Any]) -> None:
    source = Dataset.open(recorded(tmp_path / "source", **options))
    made = run(tmp_path / "source", tmp_path / "out")
    assert made.info.features == source.info.features
    assert made.info.setup == source.info.setup
    for old, new in zip(source.episodes, made.episodes, strict=True):
        assert old.content_hash == new.content_hash
        assert_equal_but_for_frames(old, new)


def test_cameras_that_were_not_there_are_drawn_and_nothing_else_changes(tmp_path: Path) -> None:
    source = recorded(tmp_path / "source", cameras=())
    made = run(source, tmp_path / "out", cameras=("wrist", "side"), image_size=SIZE, depth=True)
    for old, new in zip(Dataset.open(source).episodes, made.episodes, strict=True):
        assert_equal_but_for_frames(old, new)
        rgb = new.column("observation/frames/wrist/rgb")
        assert rgb.shape == (old.length, SIZE, SIZE, 3)
        assert len(np.unique(rgb)) > 50
        assert new.column("observation/frames/side/depth").shape == (old.length, SIZE, SIZE)


def test_added_frames_are_those_that_a_recording_in_the_same_states_has(dataset: Path, tmp_path: Path) -> None:
    # Without its frames and with them again: the scene keeps both cameras throughout.
    run(dataset, tmp_path / "blind", cameras=())
    again = run(tmp_path / "blind", tmp_path / "again", cameras=("wrist", "side"))
    for old, new in zip(Dataset.open(dataset).episodes, again.episodes, strict=True):
        assert old.content_hash == new.content_hash
        assert new.outcome["source"]["dataset"] == "blind"
        assert new.outcome["source"]["source"]["dataset"] == "dataset"


def test_dropped_cameras_leave_their_mark_on_the_scene_and_not_on_the_data(dataset: Path, tmp_path: Path) -> None:
    made = run(dataset, tmp_path / "out", cameras=("side",))
    assert not [feature.key for feature in made.info.features if "wrist" in feature.key]
    for old, new in zip(Dataset.open(dataset).episodes, made.episodes, strict=True):
        assert_equal_but_for_frames(old, new)
        key = "observation/frames/side/rgb"
        assert list(old.encoded_frames(key)) == list(new.encoded_frames(key))


def test_size_and_quality_change_frames_alone(tmp_path: Path) -> None:
    source = recorded(tmp_path / "source", cameras=("side",), max_episode_steps=2)
    made = run(source, tmp_path / "out", image_size=64, render_quality="full", camera_noise=True)
    assert setup_of(made).render_quality == "full"
    for old, new in zip(Dataset.open(source).episodes, made.episodes, strict=True):
        assert_equal_but_for_frames(old, new)
        assert new.column("observation/frames/side/rgb").shape[1:] == (64, 64, 3)


def test_a_slower_camera_repeats_its_frames_and_says_so(dataset: Path, tmp_path: Path) -> None:
    made = run(dataset, tmp_path / "out", camera_fps=15.0)
    for old, new in zip(Dataset.open(dataset).episodes, made.episodes, strict=True):
        assert_equal_but_for_frames(old, new)
        flags = new.column("flags/frames/side")
        assert flags[0] == 0
        assert (flags[1::2] == 1).all()
        before, after = (list(episode.encoded_frames("observation/frames/side/rgb")) for episode in (old, new))
        assert after[::2] == before[::2]
        assert after[1::2] == before[: len(after[1::2]) * 2 : 2]


def test_looks_are_drawn_from_their_own_seed(dataset: Path, tmp_path: Path) -> None:
    drawn = {seed: run(dataset, tmp_path / str(seed), looks_seed=seed) for seed in (0, 1)}
    again = run(dataset, tmp_path / "again", looks_seed=0)
    key = "observation/frames/side/rgb"
    first = {seed: made.episodes[0].outcome["randomisation"]["table_colour"] for seed, made in drawn.items()}
    assert first[0] != first[1]
    assert first[0] != drawn[0].episodes[1].outcome["randomisation"]["table_colour"]
    assert (drawn[0].episodes[0].column(key) != drawn[1].episodes[0].column(key)).any()
    assert [e.content_hash for e in again.episodes] == [e.content_hash for e in drawn[0].episodes]
    for old, new in zip(Dataset.open(dataset).episodes, drawn[0].episodes, strict=True):
        assert_equal_but_for_frames(old, new)


def test_new_looks_keep_the_physics_that_was_drawn(tmp_path: Path) -> None:
    source = recorded(tmp_path / "source", randomisation=True)
    made = run(source, tmp_path / "out", looks_seed=7)
    for old, new in zip(Dataset.open(source).episodes, made.episodes, strict=True):
        before, after = (episode.outcome["randomisation"] for episode in (old, new))
        assert before["object_size"] == after["object_size"]
        assert before["table_colour"] != after["table_colour"]
    assert all(result.is_equal for result in replay(tmp_path / "out"))


def test_another_setup_differs_in_what_is_seen_only(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match="differs from the recorded one in robot, frequency") as refused:
        run(dataset, tmp_path / "out", robot="ur5e", frequency=10.0)
    assert "cameras, render_quality, assets, randomisation" in str(refused.value)
    assert list(tmp_path.iterdir()) == []


def test_what_was_drawn_anew_still_replays_bit_for_bit(dataset: Path, tmp_path: Path) -> None:
    made = run(dataset, tmp_path / "out", cameras=("side",), image_size=32)
    assert setup_of(made).cameras.names == ("side",)
    assert physics_of(made) == setup_of(Dataset.open(dataset))
    assert all(result.is_equal for result in replay(tmp_path / "out"))


def test_tactile_frames_stay_as_they_were_felt(tmp_path: Path) -> None:
    source = recorded(tmp_path / "source", cameras=("side",), tactile="digit", max_episode_steps=5)
    made = run(source, tmp_path / "out", image_size=32)
    for old, new in zip(Dataset.open(source).episodes, made.episodes, strict=True):
        felt = [f.key for f in old.info.features if f.is_image and "side" not in f.key]
        assert felt
        for key in felt:
            assert list(old.encoded_frames(key)) == list(new.encoded_frames(key))


def test_the_number_of_workers_changes_nothing(dataset: Path, tmp_path: Path) -> None:
    one, two = (run(dataset, tmp_path / str(n), workers=n, image_size=32) for n in (1, 2))
    assert [episode.content_hash for episode in one.episodes] == [episode.content_hash for episode in two.episodes]


def test_a_folder_that_is_taken_stays_as_it_is_and_a_failure_leaves_nothing(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("mine")
    with pytest.raises(DatasetError, match="exists already"):
        run(dataset, tmp_path / "out")
    with pytest.raises(InvalidSetup, match="size"):
        run(dataset, tmp_path / "other", image_size=0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]


def test_a_replay_that_is_stopped_leaves_nothing(dataset: Path, tmp_path: Path) -> None:
    results = rerender(dataset, tmp_path / "out")
    next(results)
    results.close()  # pyright: ignore[reportAttributeAccessIssue]  it is a generator
    assert list(tmp_path.iterdir()) == []
