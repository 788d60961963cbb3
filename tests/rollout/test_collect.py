"""A collection depends on its seed alone: not on workers, interruptions or resumptions."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from rcs_data import Dataset, DatasetWriter, edit, recover
from rcs_data.edit import Part, mix
from rcs_data.files.layout import OPEN_FOLDER
from rcs_data.index.index import Index
from rcs_data.record.compact import publish, seal

import rcs
from rcs.agents import Agent
from rcs.envs import Action, Env, Observation
from rcs.envs.observer import Note
from rcs.errors import DatasetError, InvalidSetup, RcsError
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress, episode_id
from rcs.rollout.recorded_setup import setup_of
from rcs.rollout.replay import replay

COLLECT = """
import sys, rcs
from pathlib import Path
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
for _ in collect(Collection(setup=rcs.Setup(), out=Path(sys.argv[1]), episodes=3, seed=7), Progress()):
    pass
"""


def run(collection: Collection) -> Progress:
    progress = Progress()
    for _ in collect(collection, progress):
        pass
    return progress


def plan(out: Path, **changes: object) -> Collection:
    return dataclasses.replace(Collection(setup=rcs.Setup(), out=out, episodes=3, seed=7), **changes)  # pyright: ignore[reportArgumentType]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("collect") / "dataset with spaces ü"
    assert run(plan(out)).kept == 3
    return out


def hashes(path: Path) -> list[str]:
    return [episode.content_hash for episode in Dataset.open(path).episodes]


def test_a_second_collection_has_the_same_content(dataset: Path, tmp_path: Path) -> None:
    run(plan(tmp_path / "again"))
    assert hashes(tmp_path / "again") == hashes(dataset)


def test_another_seed_has_other_content(dataset: Path, tmp_path: Path) -> None:
    run(plan(tmp_path / "other", episodes=1, seed=8))
    assert hashes(tmp_path / "other")[0] != hashes(dataset)[0]


def test_two_workers_make_the_same_dataset_as_one(dataset: Path, tmp_path: Path) -> None:
    run(plan(tmp_path / "two", workers=2))
    assert hashes(tmp_path / "two") == hashes(dataset)


def test_an_interrupted_collection_is_resumed_to_the_same_dataset(dataset: Path, tmp_path: Path) -> None:
    progress = Progress()
    for _ in collect(plan(tmp_path / "part"), progress):
        progress.is_interrupted = True
    assert progress.kept == 1
    again = run(plan(tmp_path / "part"))
    assert (again.found, again.kept) == (1, 3)
    assert hashes(tmp_path / "part") == hashes(dataset)


def fragment(path: Path, number: int, rows: int, name: str = "") -> None:
    """Leave of an attempt what a kill and a recovery leave: its first rows, without a verdict."""
    whole = Dataset.open(path)[episode_id(number)]
    pieces = [pa.concat_tables(whole.rows()).slice(0, rows)]
    about = {**whole.about, "id": name or whole.id, "success": None, "outcome": {"recovered": True}}
    with DatasetWriter.open(path, whole.info, resume=True) as writer:
        writer.remove_episode(whole.id)
        opened = path / OPEN_FOLDER / about["id"]
        opened.mkdir()
        seal(opened, whole.info, pieces, about)
        publish(Index(path), about["id"])


@pytest.mark.parametrize("workers", [1, 2])
def test_parts_of_attempts_do_not_count_and_are_collected_again(dataset: Path, tmp_path: Path, workers: int) -> None:
    path = shutil.copytree(dataset, tmp_path / "part")
    fragment(path, 1, 20)
    progress = run(plan(path, workers=workers))
    assert (progress.found, progress.again, progress.kept) == (2, 1, 3)
    assert [attempt.number for attempt in progress.attempts] == [1]
    assert hashes(path) == hashes(dataset)
    assert all(episode.success is not None for episode in Dataset.open(path))


def test_collections_killed_and_recovered_end_as_one_that_was_not(dataset: Path, tmp_path: Path) -> None:
    path = tmp_path / "killed"
    for seconds in (0.0, 0.7):
        with subprocess.Popen([sys.executable, "-c", COLLECT, str(path)]) as process:
            deadline = time.monotonic() + 60
            while not list((path / "open").glob("*/rows.arrows")):
                assert time.monotonic() < deadline and process.poll() is None
                time.sleep(0.01)
            time.sleep(seconds)
            process.kill()
        recover(path)
    run(plan(path))
    assert hashes(path) == hashes(dataset)


def test_episodes_that_no_attempt_made_stay(dataset: Path, tmp_path: Path) -> None:
    path = shutil.copytree(dataset, tmp_path / "more")
    fragment(path, 1, 20, "by hand")
    assert run(plan(path)).again == 0
    assert "by hand" in Dataset.open(path)


def test_a_mix_of_collections_replays_bit_for_bit(dataset: Path, tmp_path: Path) -> None:
    run(plan(tmp_path / "other", episodes=2, seed=8))
    mix([Part(path=dataset, episodes=2), Part(path=tmp_path / "other")], tmp_path / "mixed", seed=1)
    results = list(replay(tmp_path / "mixed"))
    assert len(results) == 4
    assert all(result.is_equal for result in results)
    assert setup_of(Dataset.open(tmp_path / "mixed")) == setup_of(Dataset.open(dataset))
    split = edit.split(tmp_path / "mixed", tmp_path / "parts")
    assert split["other"].digest() == Dataset.open(tmp_path / "other").digest()
    assert split["other"].info == Dataset.open(tmp_path / "other").info


def test_a_complete_collection_has_nothing_to_do(dataset: Path) -> None:
    assert run(plan(dataset)).attempts == []


def test_the_first_row_is_the_reset_observation(dataset: Path) -> None:
    env = rcs.make(rcs.Setup())
    episode = Dataset.open(dataset).episodes[0]
    observation, _ = env.reset(seed=episode.seed)
    np.testing.assert_array_equal(episode.column("observation/joints")[0], observation["joints"])
    assert episode.column("simulated_time")[0] == 0.0
    assert np.isnan(episode.column("reward")[0])


def test_the_executed_action_is_what_the_arm_was_sent(dataset: Path) -> None:
    episode = Dataset.open(dataset).episodes[0]
    executed, given = episode.column("executed/joints")[1:], episode.column("action/joints")[1:]
    first = episode.column("observation/joints")[0]
    np.testing.assert_allclose(executed, first + np.cumsum(given, axis=0), atol=1e-9)


def test_times_are_measured_and_never_go_back(dataset: Path) -> None:
    for episode in Dataset.open(dataset).episodes:
        assert (np.diff(episode.column("time/monotonic")) > 0).all()
        np.testing.assert_allclose(np.diff(episode.column("simulated_time")).mean(), 1 / 30, rtol=0.01)


def test_every_episode_replays_bit_for_bit(dataset: Path) -> None:
    results = list(replay(dataset))
    assert len(results) == 3
    assert all(result.is_equal for result in results)


def test_a_changed_state_is_found_by_replay(dataset: Path) -> None:
    from rcs.envs.assemble import assemble
    from rcs.rollout.replay import replay_episode
    from rcs.setups.make import resolve

    episode = Dataset.open(dataset).episodes[0]
    states = episode.sim_state().copy()
    states[40, 3] = np.nextafter(states[40, 3], 1.0)
    episode.sim_state = lambda: states  # pyright: ignore[reportAttributeAccessIssue]  one bit of one number
    result = replay_episode(assemble(resolve(rcs.Setup())), episode)
    assert result.first_difference == 40
    assert result.begins_at_reset


def test_of_a_trimmed_episode_replay_says_that_it_begins_in_motion(dataset: Path, tmp_path: Path) -> None:
    path = shutil.copytree(dataset, tmp_path / "trimmed")
    edit.trim(path, Dataset.open(path).episodes[0].id, first=20)
    first, *others = replay(path)
    assert not first.is_equal
    assert not first.begins_at_reset
    assert all(result.is_equal and result.begins_at_reset for result in others)


def test_only_success_keeps_trying_until_there_are_enough(tmp_path: Path) -> None:
    # Too few steps for a pick that starts far away: some attempts fail.
    collection = plan(tmp_path / "good", setup=rcs.Setup(max_episode_steps=112), episodes=3, only_success=True)
    progress = run(collection)
    episodes = Dataset.open(tmp_path / "good").episodes
    assert len(episodes) == 3
    assert all(episode.success for episode in episodes)
    assert len(progress.attempts) > 3
    assert {attempt.result.failure for attempt in progress.attempts} == {None, "timeout"}


def test_only_success_keeps_the_same_episodes_with_any_number_of_workers(tmp_path: Path) -> None:
    setup = rcs.Setup(max_episode_steps=112)
    for workers in (1, 3):
        run(plan(tmp_path / str(workers), setup=setup, episodes=3, only_success=True, workers=workers))
    assert hashes(tmp_path / "3") == hashes(tmp_path / "1")
    one, three = (Dataset.open(tmp_path / name).episodes for name in ("1", "3"))
    assert [episode.id for episode in one] == [episode.id for episode in three]


@pytest.fixture(scope="module")
def successes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A collection of three successes by one worker, among which are failures."""
    out = tmp_path_factory.mktemp("successes") / "one"
    run(plan(out, setup=rcs.Setup(max_episode_steps=112), only_success=True))
    return out


@pytest.mark.parametrize("workers", [1, 2])
def test_only_success_keeps_the_same_episodes_after_a_kill_of_several_workers(
    successes: Path, tmp_path: Path, workers: int
) -> None:
    out = tmp_path / "killed"
    collection = plan(out, setup=rcs.Setup(max_episode_steps=112), episodes=5, only_success=True, workers=3)
    attempts = collect(collection, progress := Progress())
    while progress.kept < 4:
        next(attempts)
    attempts.close()
    info = Dataset.open(out).info
    with DatasetWriter.open(out, info, resume=True) as writer:  # as if its worker had been slow, and was killed
        writer.remove_episode(min(writer.taken()))
    collection = dataclasses.replace(collection, episodes=3, workers=workers)
    assert run(collection).kept == 3
    assert hashes(out) == hashes(successes)
    assert run(collection).attempts == [], "it is complete"


@pytest.mark.parametrize("workers", [1, 2])
def test_only_success_gives_up_when_nothing_ever_succeeds(tmp_path: Path, workers: int) -> None:
    setup = rcs.Setup(max_episode_steps=2)
    collection = plan(tmp_path / "none", setup=setup, only_success=True, most_attempts=5, workers=workers)
    progress = Progress()
    with pytest.raises(RcsError, match=r"Of 5 attempts 0 succeeded, and 3 were wanted.* most_attempts"):
        for _ in collect(collection, progress):
            pass
    assert sorted(attempt.number for attempt in progress.attempts) == list(range(5))
    assert progress.seconds > 0


def test_only_success_that_gave_up_goes_on_when_it_may_try_more(tmp_path: Path) -> None:
    setup = rcs.Setup(max_episode_steps=112)
    with pytest.raises(RcsError, match="gives up"):
        run(plan(tmp_path / "good", setup=setup, only_success=True, most_attempts=3))
    assert run(plan(tmp_path / "good", setup=setup, only_success=True)).kept == 3


def test_how_often_only_success_tries_depends_on_whether_anything_succeeded(tmp_path: Path) -> None:
    few, many = (plan(tmp_path, episodes=episodes, only_success=True) for episodes in (3, 50))
    assert few.attempts_before_giving_up(0) == many.attempts_before_giving_up(0) == 100
    assert (few.attempts_before_giving_up(1), many.attempts_before_giving_up(1)) == (100, 1000)
    assert plan(tmp_path, most_attempts=7).attempts_before_giving_up(1) == 7


def test_the_setup_in_a_dataset_makes_the_same_environment(dataset: Path) -> None:
    assert setup_of(Dataset.open(dataset)) == rcs.Setup()


def test_a_dataset_of_another_setup_is_refused_with_what_differs(dataset: Path) -> None:
    before = hashes(dataset)
    with pytest.raises(DatasetError, match=r"control.*'joints'.*'tquat'"):
        run(plan(dataset, setup=rcs.Setup(control="tquat")))
    assert hashes(dataset) == before


@pytest.mark.parametrize(
    ("field", "value"), [("episodes", 0), ("episodes", -3), ("seed", -1), ("workers", 0), ("most_attempts", 0)]
)
def test_counts_that_make_no_sense_are_refused(tmp_path: Path, field: str, value: int) -> None:
    with pytest.raises(InvalidSetup, match=field):
        plan(tmp_path, **{field: value})


def test_synchronous_steps_are_not_recorded_as_a_fixed_rate(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match="sync"):
        plan(tmp_path, setup=rcs.Setup(stepping="sync"))


def test_a_task_without_an_expert_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match="no scripted expert"):
        run(plan(tmp_path / "none", setup=rcs.Setup(task="Free")))
    assert not (tmp_path / "none").exists()


class Unsteady(Agent):
    """Stays where it is, and loses the connection to its policy in the second of all episodes."""

    begun = 0

    def __init__(self, env: Env) -> None:
        self._action: Any = env.action_space.sample()
        self._action["joints"][:] = 0.0

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        Unsteady.begun += 1

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        return self._action

    note_fields = (Note("begun"),)
    failure, failure_message = "policy", "ConnectionLost: gone"

    def notes(self) -> Mapping[str, Any]:
        return {"begun": float(self.begun)}

    @property
    def is_lost(self) -> bool:
        return self.begun == 2


@pytest.mark.parametrize("only_success", [False, True])
def test_an_episode_in_which_the_policy_was_lost_is_no_failure_and_the_same_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, only_success: bool
) -> None:
    monkeypatch.setattr(Unsteady, "begun", 0)
    setup, out = rcs.Setup(max_episode_steps=3), tmp_path / "data"
    collection = plan(out, setup=setup, agent=Unsteady, only_success=only_success, most_attempts=3)
    with pytest.raises(RcsError, match=r"The policy was lost: ConnectionLost: gone\. Episode 1 is left out; .* go on"):
        run(collection)
    assert [episode.id for episode in Dataset.open(out)] == ([] if only_success else [episode_id(0)])
    if only_success:
        with pytest.raises(RcsError, match="gives up"):
            run(collection)
    else:
        assert run(collection).kept == 3
        notes = [episode.column("notes/begun")[1:].tolist() for episode in Dataset.open(out).episodes]
        assert notes == [[1.0] * 3, [3.0] * 3, [4.0] * 3], "what an agent notes is recorded"


def test_an_error_in_a_worker_reaches_the_caller(tmp_path: Path, dataset: Path) -> None:
    from rcs.rollout.pool import WorkerPool

    with WorkerPool(FailingWork(), 2) as pool, pytest.raises(Exception, match="out of order"):
        list(pool.map(iter(range(3))))


class FailingWork:
    """Makes a worker that fails; at module level, so that it can be sent to a process."""

    def __call__(self) -> FailingWork:
        return self

    def attempt(self, number: int) -> int:
        raise ValueError("out of order")

    def close(self) -> None:
        return
