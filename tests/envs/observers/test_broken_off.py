"""Recordings that are broken off: by faults at random moments, by errors, by closing."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter, check

import rcs
from rcs.envs.observer import Transition
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.record import record_all
from rcs.envs.observers.recorder import Recorder
from rcs.errors import DatasetError
from tests.envs.notebook import Notebook

TRIALS = 200
LONGEST = 2.0
"""Longest time to the fault [s]: 60 steps at 30 Hz."""


def spoil(bench: Any, kind: str, which: int) -> None:
    """Have something go wrong."""
    if kind == "fault of an arm":
        bench.arms[which].set_fault("touched something")
    elif kind == "fault of a gripper":
        bench.grippers[which].set_fault("the fingers are blocked")
    elif kind == "lost link":
        bench.arms[which].lose_link()
    else:
        raise KeyboardInterrupt


KINDS = ("fault of an arm", "fault of a gripper", "lost link", "Ctrl-C")


@pytest.mark.slow
def test_at_200_random_moments_all_devices_hold_and_every_row_is_kept_and_flagged(
    tmp_path: Path, make_bench: Callable[..., Any]
) -> None:
    rng = np.random.default_rng(20)
    first = make_bench(robots=("left", "right"))
    rows: dict[str, list[Transition]] = {}
    ends: dict[str, str] = {}
    with DatasetWriter.open(tmp_path, dataset_info(first.env)) as writer:
        for trial in range(TRIALS):
            bench = make_bench(robots=("left", "right"), max_episode_steps=None)
            env, notebook = bench.env, Notebook()
            recorder = Recorder(writer, background=trial % 2 == 1)
            env.add_observer(notebook)
            env.add_observer(recorder)
            name, kind, which = f"{trial:03d}", KINDS[trial % len(KINDS)], int(rng.integers(2))
            moment, sleep = bench.clock.now + rng.uniform(0.0, LONGEST), bench.clock.sleep

            def sleep_and_spoil(
                seconds: float, bench=bench, sleep=sleep, moment=moment, kind=kind, which=which
            ) -> None:
                before = bench.clock.now
                sleep(seconds)
                if before <= moment < bench.clock.now:
                    spoil(bench, kind, which)

            env.clock._sleep = sleep_and_spoil
            recorder.name_next(name)
            env.action_space.seed(trial)
            env.reset(seed=trial)
            is_over = False
            try:
                while not is_over:
                    *_, is_over, info = env.step(env.action_space.sample())
                ends[name] = info["end"]
            except KeyboardInterrupt:
                ends[name] = "exception"
            before = [arm.body.values.copy() for arm in bench.arms]
            bench.clock.now += 1.0
            for arm, joints in zip(bench.arms, before, strict=True):
                arm.body.move()
                np.testing.assert_array_equal(arm.body.values, joints)
            rows[name] = notebook.seen
            env.close()
            assert not any(device.is_open for device in [*bench.arms, *bench.grippers])
    kept = {episode.id: episode for episode in Dataset.open(tmp_path).episodes}
    assert kept.keys() == rows.keys()
    for name, episode in kept.items():
        assert episode.length == len(rows[name])
        assert episode.success is None
        assert episode.outcome["end"] == ends[name] != "period"
        assert episode.outcome["reasons"]
        for robot in ("left", "right"):
            taken = np.stack([row.observation[robot]["joints"] for row in rows[name]])
            np.testing.assert_array_equal(episode.column(f"observation/{robot}/joints"), taken)
    assert len(set(map(len, rows.values()))) > 20, "the moments differ"
    assert not check(tmp_path).damage


@pytest.fixture
def recorded(tmp_path: Path, make_bench: Callable[..., Any]) -> Any:
    """An environment on fakes that is being recorded, after three steps."""
    bench = make_bench(max_episode_steps=None)
    writer = DatasetWriter.open(tmp_path, dataset_info(bench.env, instruction="wave"))
    bench.recorder = Recorder(writer)
    bench.writer = writer
    bench.env.add_observer(bench.recorder)
    bench.recorder.start(at_reset=True)
    bench.env.reset(seed=1)
    for _ in range(3):
        bench.env.step(bench.env.action_space.sample())
    yield bench
    bench.env.close()
    writer.close()


def only_episode(path: Path) -> Any:
    (episode,) = Dataset.open(path).episodes
    return episode


def fail_while_waiting(bench: Any) -> None:
    sleep = bench.clock.sleep

    def sleep_and_fail(seconds: float) -> None:
        sleep(seconds)
        bench.arm.set_fault("touched something")

    bench.env.clock._sleep = sleep_and_fail


def test_the_next_reset_keeps_what_a_fault_broke_off(recorded: Any, tmp_path: Path) -> None:
    fail_while_waiting(recorded)
    recorded.env.step(recorded.env.action_space.sample())
    recorded.env.recover()
    recorded.env.reset()
    episode = only_episode(tmp_path)
    assert (episode.length, episode.success, episode.instruction) == (5, None, "wave")
    assert episode.outcome["reasons"] == {"fake arm": "touched something"}
    assert bool(episode.column("truncated")[-1])


def test_an_episode_recorded_unasked_says_why_a_fault_broke_it_off(
    tmp_path: Path, make_bench: Callable[..., Any]
) -> None:
    bench = make_bench()
    with record_all(bench.env, tmp_path):
        bench.env.reset(seed=1)
        fail_while_waiting(bench)
        bench.env.step(bench.env.action_space.sample())
    bench.env.close()
    episode = only_episode(tmp_path)
    assert (episode.length, episode.success, episode.outcome["end"]) == (2, None, "fault")
    assert episode.outcome["reasons"] == {"fake arm": "touched something"}


@pytest.mark.parametrize("copies", [None, 2])
def test_an_episode_recorded_unasked_that_diverges_is_not_judged(
    copies: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log there
    env: Any = rcs.make("PickCuboid") if copies is None else rcs.make_vec("PickCuboid", copies=copies)
    with record_all(env, tmp_path / "set"):
        env.reset(seed=0)
        env.step(env.action_space.sample())
        env.simulation.world.qvel[..., 0] = np.nan
        env.step(env.action_space.sample())
    env.close()
    kept = [(one.length, one.success, one.outcome["end"]) for one in Dataset.open(tmp_path / "set").episodes]
    assert kept == [(2, None, "diverged")] * (copies or 1)


def test_a_step_that_a_device_in_fault_took_no_part_in_is_no_row(recorded: Any, tmp_path: Path) -> None:
    recorded.arm.set_fault("touched something")
    recorded.env.step(recorded.env.action_space.sample())
    recorded.env.close()
    assert only_episode(tmp_path).length == 4


def test_a_person_may_judge_or_discard_what_a_fault_broke_off(recorded: Any, tmp_path: Path) -> None:
    recorded.arm.set_fault("touched something")
    recorded.env.step(recorded.env.action_space.sample())
    record = recorded.recorder.finish(success=False)
    assert (record.success, record.outcome["end"]) == (False, "fault")
    recorded.env.recover()
    recorded.recorder.start(at_reset=True)
    recorded.env.reset()
    recorded.arm.set_fault("again")
    recorded.env.step(recorded.env.action_space.sample())
    recorded.recorder.discard()
    assert only_episode(tmp_path).id == "000000"


def test_closing_keeps_an_episode_that_is_open(recorded: Any, tmp_path: Path) -> None:
    recorded.env.close()
    episode = only_episode(tmp_path)
    assert (episode.length, episode.success, episode.outcome["end"]) == (4, None, "closed")


def test_closing_the_dataset_first_keeps_an_episode_that_is_open(recorded: Any, tmp_path: Path) -> None:
    recorded.writer.close()
    assert only_episode(tmp_path).outcome["end"] == "closed"


def test_a_reset_without_a_fault_does_the_episode_again(recorded: Any, tmp_path: Path) -> None:
    recorded.env.reset()
    assert not Dataset.open(tmp_path).episodes


def test_a_disk_that_is_full_when_the_recorder_closes_leaves_no_device_open(
    recorded: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(DatasetError, match="No space left"):
        recorded.env.close()
    assert not recorded.arm.is_open
    assert not recorded.gripper.is_open
    monkeypatch.undo()


def test_what_a_device_records_can_be_read_like_any_other(recorded: Any, tmp_path: Path) -> None:
    recorded.recorder.finish(success=True)
    dataset = Dataset.open(tmp_path)
    assert dataset.info.sim_state_size is None
    assert dataset.info.instruction == "wave"
    joints = dataset.episodes[0].column("observation/joints")
    assert joints.shape == (4, 7)
    assert all((a != b).any() for a, b in itertools.pairwise(joints))
    assert not check(tmp_path).damage


def test_a_simulation_that_diverges_is_kept_too_without_a_row_of_another_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log there
    env = rcs.make("Free")
    with DatasetWriter.open(tmp_path / "set", dataset_info(env)) as writer:
        recorder = Recorder(writer)
        env.add_observer(recorder)
        recorder.name_next("a")
        env.reset(seed=0)
        env.step(env.action_space.sample())
        env.simulation.world.qvel[0] = np.nan
        env.step(env.action_space.sample())
        env.close()
    episode = only_episode(tmp_path / "set")
    assert (episode.length, episode.outcome["end"]) == (2, "diverged")
    assert list(episode.outcome["reasons"]) == ["simulation"]
    assert "time_backwards" not in {one.kind for one in check(tmp_path / "set").findings}
