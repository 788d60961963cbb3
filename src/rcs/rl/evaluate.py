"""Evaluates a checkpoint in many copies at a time, with the episodes and results of `rollout.evaluate`."""

from __future__ import annotations

from collections.abc import Iterator

from rcs.agents.agent import is_path
from rcs.envs.step.stack import for_all
from rcs.errors import InvalidSetup
from rcs.rl.policy import PolicyAgent
from rcs.rollout.batch import run_batch
from rcs.rollout.collect import Attempt
from rcs.rollout.evaluate import Evaluation, Evaluator, Summary
from rcs.setups.make import make_vec

COPIES = 32
"""Most copies at a time."""


def evaluate_in_batch(
    evaluation: Evaluation, summary: Summary | None = None, *, copies: int = COPIES, threads: int = 0
) -> Iterator[Attempt]:
    """Run the episodes of an evaluation and yield each as it ends: those that are filmed alone, all others in a batch.

    Args:
        evaluation: What to evaluate; its agent is the path of a checkpoint. `workers` is not used.
        summary: Takes the attempts; set its `is_interrupted` to end after the episodes at work.
        copies: Most episodes at a time.
        threads: Threads for physics and drawing, 0 for one per CPU.

    Raises:
        MissingDependency: The extra `rl` is not installed.
        InvalidSetup: The setup makes no sense, or the agent is none that acts in a batch.
        CorruptCheckpoint: The checkpoint is damaged.
    """
    if not is_path(evaluation.agent):
        raise InvalidSetup(f"The agent is {evaluation.agent!r}; in a batch acts the path of a checkpoint.")
    summary = Summary() if summary is None else summary
    numbers = range(evaluation.episodes)
    filmed = numbers[: evaluation.videos]
    alone = Evaluator(evaluation) if filmed else None
    try:
        for number in filmed:
            if summary.is_interrupted or alone is None:
                return
            summary.attempts.append(alone.attempt(number))
            yield summary.attempts[-1]
    finally:
        for_all([] if alone is None else [alone.close])
    left = numbers[len(filmed) :]
    if not left:
        return
    envs = make_vec(evaluation.setup, copies=min(copies, len(left)), threads=threads, autoreset="Disabled")
    try:
        agent = PolicyAgent.load(evaluation.agent, envs)
        for attempt in run_batch(envs, agent, _until(left, summary), evaluation.seed_of):
            summary.attempts.append(attempt)
            yield attempt
    finally:
        envs.close()


def _until(numbers: range, summary: Summary) -> Iterator[int]:
    for number in numbers:
        if summary.is_interrupted:
            return
        yield number
