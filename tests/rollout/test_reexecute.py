"""Executing recorded actions again gives exactly the recording, unless the world has changed."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset
from rcs_data.edit import merge, resample

import rcs
from rcs.errors import DatasetError, InvalidSetup
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.reexecute import ReexecutionResult, deviation, reexecute
from rcs.rollout.replay import replay


def recorded(out: Path, seed: int = 1, **options: Any) -> Path:
    setup = rcs.Setup(cameras=(), **options)
    for _ in collect(Collection(setup=setup, out=out, episodes=2, seed=seed), Progress()):
        pass
    return out


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("reexecute") / "dataset")


def run(**options: Any) -> list[ReexecutionResult]:
    return sorted(reexecute(**options), key=lambda result: result.episode_id)


def test_recorded_actions_lead_to_the_very_same_rows(dataset: Path, tmp_path: Path) -> None:
    results = run(source=dataset, out=tmp_path / "out")
    before, after = Dataset.open(dataset), Dataset.open(tmp_path / "out")
    for result, old, new in zip(results, before.episodes, after.episodes, strict=True):
        assert result.success
        assert set(result.errors) == {"joints", "position", "rotation", "object_position", "object_rotation"}
        assert all(len(rows) == old.length for rows in result.errors.values())
        assert not any(any(result.errors[name]) for name in ("joints", "position", "object_position"))
        assert old.content_hash == new.content_hash
        assert old.sim_state().tobytes() == new.sim_state().tobytes()


def test_two_arms_are_executed_again_both(tmp_path: Path) -> None:
    source = recorded(tmp_path / "source", task="LiftBar", robot="dual_fr3")
    assert all(
        result.success and not any(result.errors["joints"]) for result in run(source=source, out=tmp_path / "out")
    )


def test_each_deviation_is_measured_where_it_is() -> None:
    poses = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    one = {"joints": np.zeros(3), "tcps": poses, "objects": poses}
    tcps, objects = poses + [0, 0.02, 0, 0, 0, 0, 0], np.array([[0, 0, 0, 0, 0, np.sin(0.1), np.cos(0.1)]])
    found = deviation(one, {"joints": np.array([0.0, -0.3, 0.1]), "tcps": tcps, "objects": objects})
    expected = {"joints": 0.3, "position": 0.02, "rotation": 0.0, "object_position": 0.0, "object_rotation": 0.2}
    assert found == pytest.approx(expected, abs=1e-12)
    empty = {**one, "objects": np.empty((0, 7))}
    assert deviation(empty, empty) == {"joints": 0.0, "position": 0.0, "rotation": 0.0}


def test_another_world_is_seen_as_a_deviation(tmp_path: Path) -> None:
    setup = rcs.Setup(cameras=())
    env = rcs.make(setup)
    env.simulation.world.model.jnt_actfrcrange[env.simulation.robots[0].layout.joint_ids] *= 0.1  # a weak arm
    for _ in collect(Collection(setup=setup, out=tmp_path / "source", episodes=1, seed=1), Progress(), env):
        pass
    (result,) = run(source=tmp_path / "source", out=tmp_path / "out")
    assert result.errors["joints"][0] == 0.0
    assert result.summary()["joints"]["max"] > 0.02
    (episode,) = Dataset.open(tmp_path / "out").episodes
    assert episode.outcome["source"]["errors"] == result.summary()


def test_randomised_episodes_are_executed_in_their_own_worlds(tmp_path: Path) -> None:
    source = recorded(tmp_path / "source", randomisation=True)
    assert all(not any(result.errors["joints"]) for result in run(source=source, out=tmp_path / "out"))
    kept = [Dataset.open(tmp_path / name).episodes[0].outcome["randomisation"] for name in ("source", "out")]
    assert kept[0] == kept[1]


@pytest.mark.gl
def test_frames_are_drawn_of_what_is_executed(dataset: Path, tmp_path: Path) -> None:
    # A camera on the wrist has a mass, so the arm moves a little differently with it.
    run(source=dataset, out=tmp_path / "out", setup=rcs.Setup(cameras=rcs.Cameras("side", image_size=32)))
    frames = Dataset.open(tmp_path / "out").episodes[0].column("observation/frames/side/rgb")
    assert frames.shape[1:] == (32, 32, 3)
    assert np.ptp(frames.astype(int), axis=0).max() > 50  # something moves


def test_an_existing_folder_is_refused(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("mine")
    with pytest.raises(DatasetError, match="exists already"):
        run(source=dataset, out=tmp_path / "out")
    assert (tmp_path / "out" / "mine").read_text() == "mine"


def test_merged_datasets_are_replayed_as_one_and_those_of_different_setups_are_refused(
    dataset: Path, tmp_path: Path
) -> None:
    other = recorded(tmp_path / "other", seed=2)
    merge([dataset, other], tmp_path / "merged")
    assert len(run(source=tmp_path / "merged", out=tmp_path / "out")) == 4
    slower = recorded(tmp_path / "slower", physics_step=0.001)
    merge([dataset, slower], tmp_path / "mixed")
    with pytest.raises(InvalidSetup, match="physics_step"):
        run(source=tmp_path / "mixed", out=tmp_path / "none")


def test_a_dataset_at_a_lower_rate_than_it_was_recorded_at_is_refused(dataset: Path, tmp_path: Path) -> None:
    shutil.copytree(dataset, tmp_path / "slow")
    resample(tmp_path / "slow", 10.0)
    with pytest.raises(InvalidSetup, match="recorded at 30 Hz"):
        run(source=tmp_path / "slow", out=tmp_path / "out")
    with pytest.raises(InvalidSetup, match="recorded at 30 Hz"):
        list(replay(tmp_path / "slow"))
