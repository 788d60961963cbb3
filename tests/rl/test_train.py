"""A training that is killed at any moment and goes on ends with the same weights, bit for bit."""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.errors import CorruptCheckpoint, DatasetError, InvalidSetup, MissingDependency
from rcs.rl import Dagger

pytestmark = pytest.mark.extras

Weights = Callable[[Path], dict[str, Any]]
TRAIN = Path(__file__).with_name("kill_training.py")


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Any, str], Path]:
    """Return a function that trains without a break, once per algorithm."""
    made: dict[str, Path] = {}

    def train(small: Any, name: str) -> Path:
        if name not in made:
            made[name] = tmp_path_factory.mktemp("whole") / name
            small.run(small.training(name), made[name])
        return made[name]

    return train


@pytest.mark.parametrize("name", ["ppo", "steady"])
def test_a_run_that_is_broken_off_again_and_again_ends_like_one_that_is_not(
    small: Any, whole: Any, weights: Weights, tmp_path: Path, name: str
) -> None:
    reference, out = whole(small, name), tmp_path / "run"
    draw = random.Random(3)
    progress = small.run(small.training(name), out, updates=draw.randint(1, 12))
    while progress.doing != "done":
        progress = small.run(small.training(name), out, updates=draw.randint(10, 18))
    assert same(weights(out), weights(reference))
    rows = [[json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()] for run in (reference, out)]
    for row in (row for run in rows for row in run):
        row["figures"].pop("time/steps_per_s", None)
    assert [(row["steps"], row["figures"]) for row in rows[0]] == [(row["steps"], row["figures"]) for row in rows[1]]


def test_evaluations_checkpoints_and_threads_of_physics_change_no_weight(
    small: Any, whole: Any, weights: Weights, tmp_path: Path
) -> None:
    from rcs.rl.train import train

    other = small.training(episodes=0, checkpoint_every=1000)
    for _ in train(other, tmp_path / "other", threads=2, videos=False):
        pass
    assert same(weights(tmp_path / "other"), weights(whole(small, "ppo")))


def test_an_evaluation_may_take_longer_than_episodes_of_training(small: Any, tmp_path: Path) -> None:
    from rcs.rl.checkpoint import checkpoints_of, open_checkpoint

    small.run(small.training(steps=20, evaluation_steps=12, checkpoint_every=0), tmp_path / "run")
    (first, *_) = (open_checkpoint(place) for place in checkpoints_of(tmp_path / "run"))
    assert first.training.setup.max_episode_steps == 7
    assert first.score is not None and first.score.length == 12


def test_another_seed_gives_other_weights(small: Any, whole: Any, weights: Weights, tmp_path: Path) -> None:
    small.run(small.training(seed=1), tmp_path / "run")
    assert not same(weights(tmp_path / "run"), weights(whole(small, "ppo")))


@pytest.mark.parametrize("file", ["policy.pt", "learner.pt", "checkpoint.json"])
def test_a_damaged_checkpoint_is_named_and_the_one_before_is_gone_on_from(
    small: Any, whole: Any, weights: Weights, tmp_path: Path, file: str
) -> None:
    out = tmp_path / "run"
    small.run(small.training(), out, updates=20)
    newest = max((out / "checkpoints").iterdir())
    data = bytearray((newest / file).read_bytes())
    data[len(data) // 2] ^= 1
    (newest / file).write_bytes(data)
    progress = small.run(small.training(), out)
    assert any(str(newest) in note and "The one before is tried" in note for note in progress.notes)
    assert same(weights(out), weights(whole(small, "ppo")))


def test_a_damaged_old_checkpoint_is_in_nobodys_way(small: Any, whole: Any, weights: Weights, tmp_path: Path) -> None:
    out = tmp_path / "run"
    small.run(small.training(), out, updates=20)
    oldest = min((out / "checkpoints").iterdir())
    (oldest / "checkpoint.json").write_bytes(b"nothing")
    small.run(small.training(), out)
    assert same(weights(out), weights(whole(small, "ppo")))


@pytest.mark.parametrize("damage", [lambda path: path.write_bytes(b"nothing"), lambda path: path.unlink()])
def test_where_all_checkpoints_are_damaged_nothing_is_removed(small: Any, tmp_path: Path, damage: Any) -> None:
    out = tmp_path / "run"
    small.run(small.training(), out, updates=20)
    before = sorted((out / "checkpoints").iterdir())
    for place in before:
        if (place / "learner.pt").exists():
            damage(place / "learner.pt")
    with pytest.raises(CorruptCheckpoint, match=r"No checkpoint of .* is left to continue from"):
        small.run(small.training(), out)
    assert sorted((out / "checkpoints").iterdir()) == before


def test_a_finished_run_has_nothing_to_do(small: Any, whole: Any) -> None:
    run = whole(small, "ppo")
    before = {path: path.read_bytes() for path in (run / "checkpoints").rglob("*.pt")}
    assert small.run(small.training(), run).steps == 160
    assert {path: path.read_bytes() for path in (run / "checkpoints").rglob("*.pt")} == before


def test_old_checkpoints_keep_what_acts_and_only_the_newest_what_learns(small: Any, whole: Any) -> None:
    places = sorted((whole(small, "ppo") / "checkpoints").iterdir())
    steps = [int(place.name) for place in places]
    assert steps == [0, 60, 120, 140, 160]  # those that were evaluated, and the newest three
    assert [place for place in places if (place / "learner.pt").exists()] == places[-3:]


def test_a_run_is_of_one_training(small: Any, whole: Any, tmp_path: Path) -> None:
    run = shutil.copytree(whole(small, "ppo"), tmp_path / "run")
    with pytest.raises(InvalidSetup, match=r"another training began: seed is 1, not 0. Give the same options"):
        small.run(small.training(seed=1), run)
    with pytest.raises(InvalidSetup, match="steps is 200, not 160"):  # the step size falls to zero by the last one
        small.run(small.training(steps=200), run)


def test_of_another_algorithm_only_its_name_is_said(small: Any, whole: Any, tmp_path: Path) -> None:
    run = shutil.copytree(whole(small, "ppo"), tmp_path / "run")
    with pytest.raises(InvalidSetup, match=r"another training began: the algorithm is 'dagger', not 'ppo'\. Give"):
        small.run(small.training(algorithm=Dagger()), run)


@pytest.mark.parametrize("device", ["tpu", "meta", "cuda:99"])
def test_a_device_that_is_not_there_is_refused_before_anything_is_written(
    small: Any, tmp_path: Path, device: str
) -> None:
    with pytest.raises(InvalidSetup, match=f"device is '{device}', on which torch cannot compute here; valid is cpu"):
        small.run(small.training(device=device), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_what_was_refused_leaves_the_folder_to_the_next_training(small: Any, tmp_path: Path) -> None:
    training = small.training()
    setup = replace(training.setup, relative="last_step", layers=("ObserveTarget",))
    right = replace(training, setup=setup, algorithm=Dagger(n_steps=2, warm_up=4, gradient_steps=1))
    with pytest.raises(InvalidSetup, match="PickTeacher gives joints"):
        small.run(replace(right, setup=replace(setup, control="twist", layers=())), tmp_path / "run")
    assert small.run(right, tmp_path / "run", updates=1).doing == "evaluating"


def test_a_task_without_reward_is_refused(small: Any, tmp_path: Path) -> None:
    training = small.training()
    free = replace(training, setup=replace(training.setup, task="Free", observe=()))
    with pytest.raises(InvalidSetup, match=r"Free has no reward, so there is nothing to learn; train a task"):
        small.run(free, tmp_path / "run")


def test_a_run_whose_step_size_stays_can_be_made_longer(small: Any, weights: Weights, tmp_path: Path) -> None:
    small.run(small.training("steady", steps=100), tmp_path / "longer")
    small.run(small.training("steady", steps=140), tmp_path / "longer")
    small.run(small.training("steady", steps=140), tmp_path / "whole")
    assert same(weights(tmp_path / "longer"), weights(tmp_path / "whole"))


def test_one_process_trains_in_a_folder(small: Any, tmp_path: Path) -> None:
    from rcs.rl.train import train

    running = train(small.training(), tmp_path / "run", threads=1, videos=False)
    next(running)
    with pytest.raises(DatasetError, match=rf"Another process, {os.getpid()}, trains in"):
        small.run(small.training(), tmp_path / "run")
    running.close()


def test_a_folder_with_other_things_in_it_is_left_alone(small: Any, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("all of it")
    with pytest.raises(DatasetError, match="has other things in it"):
        small.run(small.training(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_without_torch_the_error_names_the_extra(small: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingDependency, match=r"needs torch: pip install 'robot-control-stack\[rl\]'"):
        small.run(small.training(), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
def test_sigkill_at_any_moment_costs_no_checkpoint_and_changes_no_weight(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, str(TRAIN), "--trials", "2"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["kills"], told["kills_at_work"], told["lost_checkpoints"], told["same_weights"]) == (2, 2, 0, True)
