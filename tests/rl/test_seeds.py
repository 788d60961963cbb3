"""Trainings with several seeds at a time end like each alone, whether machines share a folder or not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.rl.seeds import Trained, _Work, run_of, train_seeds
from rcs.rollout.remote_files import FileWorker, write_files

Weights = Callable[[Path], dict[str, Any]]


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one)


@pytest.mark.cluster
def test_seeds_on_a_cluster_have_the_weights_of_trainings_alone(
    small: Any, weights: Weights, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")  # as in other tests: a process keeps the first that Ray has read
    training = small.training(episodes=0)
    small.run(replace(training, seed=3), run_of(tmp_path / "seeds", 3), updates=4)  # as a kill leaves it
    runs = {one.seed: one for one in train_seeds(training, (0, 3), tmp_path / "seeds", videos=False)}
    assert set(runs) == {0, 3}
    for seed in (0, 3):
        assert runs[seed].run == tmp_path / "seeds" / f"seed-{seed}" and runs[seed].steps == 160
        small.run(replace(training, seed=seed), tmp_path / f"alone-{seed}")
        assert same(weights(runs[seed].run), weights(tmp_path / f"alone-{seed}"))
    assert sorted(path.name for path in (tmp_path / "seeds").iterdir()) == ["seed-0", "seed-3"]


@pytest.mark.extras
def test_a_machine_that_does_not_see_the_folder_sends_its_run(small: Any, weights: Weights, tmp_path: Path) -> None:
    training = small.training(episodes=0)
    worker = _Work(training, tmp_path / "elsewhere", tmp_path / "no-sign", 1, False)()
    assert isinstance(worker, FileWorker)
    trained, files = worker.attempt(5)
    worker.close()
    write_files(files, tmp_path / "here")
    assert isinstance(trained, Trained) and not (tmp_path / "elsewhere").exists()
    small.run(replace(training, seed=5), tmp_path / "alone")
    assert same(weights(run_of(tmp_path / "here", 5)), weights(tmp_path / "alone"))


@pytest.mark.extras
def test_a_seed_is_not_trained_twice_at_a_time(small: Any, tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match=r"\[0, 0\]; valid is one or more, all different"):
        list(train_seeds(small.training(), (0, 0), tmp_path / "out"))
    assert not (tmp_path / "out").exists()
