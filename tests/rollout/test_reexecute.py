"""Executing recorded actions again: exactly what was recorded, or close to it in another control mode."""

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
from rcs.rollout.collect import Collection, Progress, collect
from rcs.rollout.derive import derive
from rcs.rollout.divergence import Tolerance
from rcs.rollout.look import Look, setup_of
from rcs.rollout.reexecute import Reexecution, ReexecutionResult
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
    return sorted(derive(Reexecution(**options)), key=lambda result: result.episode_id)


def test_recorded_actions_lead_to_the_very_same_rows(dataset: Path, tmp_path: Path) -> None:
    results = run(source=dataset, out=tmp_path / "out")
    before, after = Dataset.open(dataset), Dataset.open(tmp_path / "out")
    for result, old, new in zip(results, before.episodes, after.episodes, strict=True):
        assert result.success
        assert result.first_beyond is None
        assert not result.divergence.joints.any()
        assert not result.divergence.object_position.any()
        assert old.content_hash == new.content_hash
        assert old.sim_state().tobytes() == new.sim_state().tobytes()


@pytest.mark.parametrize(
    ("control", "relative", "most"),
    [
        ("joints", "absolute", 0.0),
        ("joints", "last_step", 1e-9),
        ("joints", "origin", 1e-9),
        ("tquat", "absolute", 4e-3),
        ("tquat", "last_step", np.inf),
        ("xyzrpy", "absolute", 4e-3),
        ("xyzrpy", "last_step", np.inf),
        ("twist", "last_step", np.inf),
    ],
)
def test_in_every_control_mode_arms_go_where_they_went(
    dataset: Path, tmp_path: Path, control: Any, relative: Any, most: float
) -> None:
    results = run(source=dataset, out=tmp_path / "out", control=control, relative=relative)
    made = setup_of(Dataset.open(tmp_path / "out"))
    assert (made.control, made.relative) == (control, relative)
    for result in results:
        assert result.success
        if most == np.inf:
            continue  # relative poses are slower than joints may be, so the arm stays behind on its way
        assert result.first_beyond is None
        assert result.divergence.joints.max() <= most
        assert result.divergence.position.max() <= most
    assert all(result.is_equal for result in replay(tmp_path / "out"))


def test_a_control_mode_without_more_is_absolute(dataset: Path, tmp_path: Path) -> None:
    run(source=dataset, out=tmp_path / "out", control="tquat")
    assert setup_of(Dataset.open(tmp_path / "out")).relative == "absolute"


def test_poses_become_joints(tmp_path: Path) -> None:
    source = recorded(tmp_path / "source", control="tquat", relative="absolute")
    results = run(source=source, out=tmp_path / "out", control="joints")
    assert all(result.success and not result.divergence.joints.any() for result in results)


def test_two_arms_are_translated_both(tmp_path: Path) -> None:
    source = recorded(tmp_path / "source", task="LiftBar", robot="dual_fr3")
    results = run(source=source, out=tmp_path / "out", control="xyzrpy")
    assert all(result.success and result.divergence.joints.max() < 0.01 for result in results)


def test_the_first_row_beyond_the_tolerance_is_told_and_kept(dataset: Path, tmp_path: Path) -> None:
    tight = Tolerance(max_position_error=1e-6)
    results = run(source=dataset, out=tmp_path / "out", control="tquat", tolerance=tight)
    for result, episode in zip(results, Dataset.open(tmp_path / "out").episodes, strict=True):
        assert result.first_beyond is not None
        row, what = result.first_beyond
        assert what == "position"
        assert (result.divergence.position[:row] <= 1e-6).all()
        assert result.divergence.position[row] > 1e-6
        assert episode.outcome["source"]["first_beyond_tolerance"] == {"row": row, "error": what}
        assert episode.outcome["source"]["episode"] == episode.id


def test_a_world_that_was_another_is_seen_as_a_divergence(tmp_path: Path) -> None:
    setup = rcs.Setup(cameras=())
    env = rcs.make(setup)
    env.scenario.world.model.jnt_actfrcrange[env.scenario.robots[0].layout.joint_ids] *= 0.1  # a weak arm
    for _ in collect(Collection(setup=setup, out=tmp_path / "source", episodes=1, seed=1), Progress(), env):
        pass
    (result,) = run(source=tmp_path / "source", out=tmp_path / "out")
    assert result.first_beyond is not None
    assert result.first_beyond[0] > 0
    assert result.divergence.joints[0] == 0.0
    assert result.divergence.joints.max() > 0.02


def test_randomised_episodes_are_executed_in_their_own_worlds(tmp_path: Path) -> None:
    source = recorded(tmp_path / "source", randomisation=True)
    assert all(not result.divergence.joints.any() for result in run(source=source, out=tmp_path / "out"))
    kept = [Dataset.open(tmp_path / name).episodes[0].outcome["randomisation"] for name in ("source", "out")]
    assert kept[0] == kept[1]


@pytest.mark.gl
def test_frames_are_drawn_of_what_is_executed(dataset: Path, tmp_path: Path) -> None:
    # A camera on the wrist has a mass, so the arm moves a little differently with it.
    run(source=dataset, out=tmp_path / "out", look=Look(cameras=("side",), image_size=32))
    frames = Dataset.open(tmp_path / "out").episodes[0].column("observation/frames/side/rgb")
    assert frames.shape[1:] == (32, 32, 3)
    assert np.ptp(frames.astype(int), axis=0).max() > 50  # something moves


def test_real_recordings_and_taken_folders_are_refused(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("mine")
    with pytest.raises(DatasetError, match="exists already"):
        run(source=dataset, out=tmp_path / "out")
    assert (tmp_path / "out" / "mine").read_text() == "mine"
    with pytest.raises(InvalidSetup, match="grace"):
        run(source=dataset, out=tmp_path / "other", grace=-1.0)


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
