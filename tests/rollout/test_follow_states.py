"""Real-to-sim replay: a simulated robot follows a real one, and the task judges.

There are no real episodes here. Simulated ones stand for them, whose world was another (weaker servos, more
damping, other friction and mass), whose states were taken away, and whose measurements have noise and come late.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature

import rcs
from rcs.errors import InvalidSetup
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.recorded_setup import setup_of
from rcs.rollout.reexecute import ReexecutionResult, reexecute
from rcs.rollout.replay import replay

EPISODES = 5
SETUP = rcs.Setup(cameras=())


def measure(
    simulated: Path,
    out: Path,
    *,
    noise: float = 0.002,
    late: int = 1,
    rate: float = 1.0,
    misplaced: float = 0.0,
    only_first: bool = False,
    setup: dict[str, Any] | None = None,
    has_objects: bool | str = True,
) -> Path:
    """Write what a real robot would have recorded of simulated episodes: measurements alone.

    Args:
        simulated: Dataset of simulated episodes.
        out: Folder of the new one.
        noise: Standard deviation of a measured joint [rad]; of an opening, 2 of this.
        late: By how many rows the opening comes late.
        rate: Rows of the new dataset in proportion to those of the other.
        misplaced: By how much the object's recorded place is off [m].
        only_first: Whether it is off in the first episode only.
        setup: Setup of the new dataset; None for that of the other.
        has_objects: Whether it is recorded where the object was; or the only episode of which it is.
    """
    source = Dataset.open(simulated)
    features = (
        Feature(key="observation/joints", shape=(7,), dtype="float64", unit="rad"),
        Feature(key="observation/gripper", shape=(1,), dtype="float32"),
    )
    known = source.info.setup if setup is None else setup
    info = DatasetInfo(frequency=source.info.frequency * rate, features=features, setup=known, instruction="pick it up")
    draws = np.random.default_rng(0)
    with DatasetWriter.open(out, info) as writer:
        for episode in source.episodes:
            joints, opening = (episode.column(f"observation/{key}") for key in ("joints", "gripper"))
            opening = np.concatenate([opening[:1].repeat(late, axis=0), opening[: len(opening) - late]])
            joints = joints + draws.normal(0.0, noise, joints.shape)
            opening = np.clip(opening + draws.normal(0.0, 2 * noise, opening.shape), 0.0, 1.0)
            times = np.arange(0.0, len(joints) - 1, 1 / rate)
            pose = np.array(episode.outcome["objects"]["cuboid"])
            angle = draws.uniform(0.0, 2 * np.pi)
            if not only_first or episode.id == "000000":
                pose[:2] += misplaced * np.array([np.cos(angle), np.sin(angle)])
            with writer.episode(episode.id, seed=None) as real:
                for time in times:
                    row = [_at(values, time) for values in (joints, opening)]
                    real.add({"observation/joints": row[0], "observation/gripper": row[1].astype(np.float32)})
                objects = {"objects": {"cuboid": pose.tolist()}}
                real.finish(True, objects if has_objects is True or episode.id == has_objects else {})
    return out


def _at(values: np.ndarray[Any, Any], time: float) -> np.ndarray[Any, Any]:
    rows = np.arange(len(values))
    return np.array([np.interp(time, rows, values[:, i]) for i in range(values.shape[1])])


@pytest.fixture(scope="module")
def other_world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Episodes of a world that is not quite the simulated one."""
    out = tmp_path_factory.mktemp("real") / "simulated"
    env = rcs.make(SETUP)
    model = env.simulation.world.model
    model.geom_friction[:, 0] *= 0.8
    model.dof_damping[:] *= 1.5
    model.body_mass[model.body("cuboid").id] *= 1.3
    arm = env.simulation.robots[0].layout.actuator_ids
    model.actuator_gainprm[arm, 0] *= 0.8
    model.actuator_biasprm[arm, 1] *= 0.8
    for _ in collect(Collection(setup=SETUP, out=out, episodes=EPISODES, seed=3), Progress(), env):
        pass
    assert all(episode.success for episode in Dataset.open(out).episodes)
    return out


def run(**options: Any) -> list[ReexecutionResult]:
    return sorted(reexecute(kind="states", **options), key=lambda result: result.episode_id)


def successes(results: list[ReexecutionResult]) -> int:
    return sum(result.success for result in results)


@pytest.mark.parametrize("noise", [0.0, 0.002, 0.01])
def test_most_real_successes_succeed_in_simulation_too(other_world: Path, tmp_path: Path, noise: float) -> None:
    results = run(source=measure(other_world, tmp_path / "real", noise=noise), out=tmp_path / "out")
    assert len(results) == EPISODES
    assert successes(results) >= EPISODES - 1
    for result in results:
        assert result.problem is None
        assert result.summary()["joints"]["median"] < 0.01 + 2.5 * noise


def test_with_the_object_5_cm_from_where_it_was_all_fail(other_world: Path, tmp_path: Path) -> None:
    results = run(
        source=measure(other_world, tmp_path / "real", misplaced=0.05), out=tmp_path / "out", only_success=True
    )
    assert successes(results) == 0
    assert len(Dataset.open(tmp_path / "out")) == 0


def test_the_new_dataset_has_the_successes_alone_and_says_where_they_are_from(
    other_world: Path, tmp_path: Path
) -> None:
    real = measure(other_world, tmp_path / "real", misplaced=0.05, only_first=True)
    objects = {episode.id: episode.outcome["objects"] for episode in Dataset.open(real).episodes}
    results = run(source=real, out=tmp_path / "out", only_success=True)
    assert not results[0].success
    kept = Dataset.open(tmp_path / "out")
    assert [episode.id for episode in kept.episodes] == [r.episode_id for r in results if r.success]
    for episode in kept.episodes:
        assert episode.success
        assert episode.outcome["source"]["dataset"] == "real"
        assert episode.outcome["source"]["episode"] == episode.id
        np.testing.assert_allclose(episode.outcome["objects"]["cuboid"], objects[episode.id]["cuboid"], atol=1e-12)
    everything = run(source=real, out=tmp_path / "all")
    assert [episode.success for episode in Dataset.open(tmp_path / "all").episodes] == [r.success for r in everything]


def test_what_was_replayed_is_a_simulated_dataset_that_replays_bit_for_bit(other_world: Path, tmp_path: Path) -> None:
    run(source=measure(other_world, tmp_path / "real"), out=tmp_path / "out")
    assert setup_of(Dataset.open(tmp_path / "out")).control == "joints"
    assert all(result.is_equal for result in replay(tmp_path / "out"))


@pytest.mark.parametrize("rate", [0.5, 5 / 3])
def test_a_recording_at_another_rate_is_interpolated(other_world: Path, tmp_path: Path, rate: float) -> None:
    real = measure(other_world, tmp_path / "real", rate=rate, late=0, noise=1e-3)
    results = run(source=real, out=tmp_path / "out")
    assert Dataset.open(tmp_path / "out").info.frequency == 30.0
    assert successes(results) >= EPISODES - 1


def test_a_setup_that_is_not_ours_needs_a_robot_and_a_task(other_world: Path, tmp_path: Path) -> None:
    real = measure(other_world, tmp_path / "real", setup={"lab": "somewhere else"})
    with pytest.raises(InvalidSetup, match="robot and a task"):
        run(source=real, out=tmp_path / "out")
    assert successes(run(source=real, out=tmp_path / "out", setup=rcs.Setup("PickCuboid"))) >= EPISODES - 1


def test_a_gripper_that_opens_by_degrees_follows_the_opening(other_world: Path, tmp_path: Path) -> None:
    real = measure(other_world, tmp_path / "real", setup=replace(SETUP, binary_gripper=False).to_json())
    assert successes(run(source=real, out=tmp_path / "out")) >= EPISODES - 1


@pytest.mark.parametrize("robot", ["so101", "dual_fr3", "xarm7"])
def test_other_robots_hands_and_two_arms_follow(tmp_path: Path, robot: str) -> None:
    task = {"so101": "PickCuboid", "dual_fr3": "LiftBar", "xarm7": "PickToy"}[robot]
    setup = replace(SETUP, task=task, robot=robot)
    for _ in collect(Collection(setup=setup, out=tmp_path / "source", episodes=1, seed=0), Progress()):
        pass
    (result,) = run(source=tmp_path / "source", out=tmp_path / "out")
    assert result.problem is None
    assert result.success
    assert all(replayed.is_equal for replayed in replay(tmp_path / "out"))


def test_a_task_with_an_object_of_unknown_place_is_refused(other_world: Path, tmp_path: Path) -> None:
    real = measure(other_world, tmp_path / "real", has_objects=False)
    with pytest.raises(InvalidSetup, match="has poses of the objects"):
        run(source=real, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_robot_with_other_joints_is_refused(other_world: Path, tmp_path: Path) -> None:
    real = measure(other_world, tmp_path / "real")
    with pytest.raises(InvalidSetup, match="observation/joints"):
        run(source=real, out=tmp_path / "out", setup=rcs.Setup(robot="ur5e"))


def test_an_episode_that_cannot_be_replayed_is_told_and_the_others_go_on(other_world: Path, tmp_path: Path) -> None:
    results = run(source=measure(other_world, tmp_path / "real", has_objects="000000"), out=tmp_path / "out")
    assert results[0].problem is None and results[0].success
    assert all(result.problem == "The objects' poses are unknown." for result in results[1:])


def test_the_number_of_workers_changes_nothing(other_world: Path, tmp_path: Path) -> None:
    real = measure(other_world, tmp_path / "real")
    one, two = (run(source=real, out=tmp_path / str(n), workers=n) for n in (1, 2))
    assert one == two
    hashes = [[episode.content_hash for episode in Dataset.open(tmp_path / str(n)).episodes] for n in (1, 2)]
    assert hashes[0] == hashes[1]


def test_arms_are_where_they_were_recorded(tmp_path: Path) -> None:
    for robot in ("fr3", "ur5e"):
        source = tmp_path / robot
        for _ in collect(Collection(setup=replace(SETUP, robot=robot), out=source, episodes=1, seed=0), Progress()):
            pass
        (followed,) = run(source=source, out=tmp_path / f"{robot} followed")
        assert followed.summary()["joints"]["median"] < 0.01
