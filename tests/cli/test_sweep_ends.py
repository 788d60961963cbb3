"""`rcs sweep` that is interrupted, or whose checkpoints are removed meanwhile: what it evaluates and chooses."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rcs.cli.sweep import SweepCommand
from rcs.errors import InvalidSetup
from rcs.rollout.collection import Attempt
from rcs.rollout.episode import EpisodeResult
from rcs.rollout.evaluation import Summary

Asked = list[tuple[int, int | None]]
"""Steps and seeds of evaluations, in their order."""


@pytest.fixture
def sweep(
    call_unwrapped: Any, tmp_path: Path, trained: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., tuple[int, str, Asked]]:
    """Return a function that sweeps without running an episode: it calls another one, with the count, for each.

    That may return what the episodes came to.
    """

    def run(evaluate: Callable[[int], Summary | None], *options: str) -> tuple[int, str, Asked]:
        asked: Asked = []

        def evaluated(_: Any, steps: int, path: Path, options: Any, console: Any, seed: int | None = None) -> Summary:
            if not path.is_dir():
                raise InvalidSetup("it is gone")
            asked.append((steps, seed))
            return evaluate(len(asked)) or Summary()

        monkeypatch.setattr(SweepCommand, "_evaluate", evaluated)
        words = ("--serve", "x {checkpoint} {port}", *options, "--out", tmp_path / "out")
        code, told = call_unwrapped("sweep", trained, *words)
        return code, told, asked

    return run


@pytest.mark.parametrize("options", [(), ("--follow",)])
def test_an_end_at_once_evaluates_nothing_more(sweep: Any, options: tuple[str, ...]) -> None:
    def end(count: int) -> None:
        if count == 2:
            raise KeyboardInterrupt  # as by SIGTERM, or by Ctrl-C for the second time

    code, told, asked = sweep(end, *options)
    assert code == 130, told
    assert asked == [(1000, None), (2000, None)]
    assert "Best of" not in told


def test_ctrl_c_while_checkpoints_are_waited_for_takes_the_best_of_those_that_are_there(
    sweep: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("rcs.cli.sweep.time", SimpleNamespace(sleep=interrupt))
    code, told, asked = sweep(lambda count: None, "--follow")
    assert code == 0, told
    assert asked == [(1000, None), (2000, None), (2000, 1 << 31)]
    assert "Best of 2, by the episodes above: 2000 steps" in told


def test_a_checkpoint_that_its_training_removes_is_left_out(sweep: Any, trained: Path) -> None:
    newest = trained / "run" / "checkpoints" / "002000"
    code, told, asked = sweep(lambda count: shutil.rmtree(newest, ignore_errors=True))
    assert code == 0, told
    assert asked == [(1000, None), (1000, 1 << 31)]
    assert "2000 steps: the training has removed this checkpoint" in told


def test_episodes_without_a_verdict_are_told_beside_the_rate_of_the_best(sweep: Any) -> None:
    verdicts = (True, False, None, None)
    results = [EpisodeResult(seed=0, steps=1, success=one, failure=None, reward=0.0) for one in verdicts]
    attempts = [Attempt(number=number, result=result) for number, result in enumerate(results)]
    code, told, _ = sweep(lambda count: Summary(attempts=attempts))
    assert code == 0, told
    assert "did not choose it: 1 of 2 judged = 50.0 %" in told
    assert "%); 2 not judged" in told
