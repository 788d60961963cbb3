"""Evaluates policies in many copies at a time: checkpoints, and a policy between two updates of its training."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from functools import partial
from itertools import chain, islice
from pathlib import Path

from rcs.agents import Agent
from rcs.agents.agent import is_path
from rcs.envs.step.stack import for_all
from rcs.errors import InvalidSetup, MissingDependency
from rcs.rl.checkpoint import Score
from rcs.rl.policy import PolicyAgent
from rcs.rl.training import Training
from rcs.rollout.batch import run_batch
from rcs.rollout.collection import Attempt
from rcs.rollout.episode import run_episode
from rcs.rollout.evaluate import evaluate
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.video import Film
from rcs.setups.make import make, make_vec

COPIES = 32
"""Most copies at a time."""


def evaluate_in_batch(
    evaluation: Evaluation, summary: Summary | None = None, *, copies: int = COPIES, threads: int = 0
) -> Iterator[Attempt]:
    """Run the episodes of an evaluation in a batch, and yield each as it ends; none is filmed.

    Args:
        evaluation: The evaluation; its agent is the path of a checkpoint. `workers` is not used.
        summary: Takes the attempts; set its `is_interrupted` to end after the running episodes.
        copies: Most episodes at a time.
        threads: Threads for physics and drawing, 0 for one per CPU.

    Raises:
        MissingDependency: The extra `rl` is not installed.
        InvalidSetup: The setup makes no sense, or the agent is not the path of a checkpoint.
        CorruptCheckpoint: The checkpoint is damaged.
    """
    if not is_path(evaluation.agent):
        raise InvalidSetup(f"Evaluation in a batch needs the path of a checkpoint; the agent is {evaluation.agent!r}.")
    yield from evaluate(evaluation, summary, maker=partial(_in_batch, copies=copies, threads=threads))


def _in_batch(evaluation: Evaluation, numbers: Iterator[int], *, copies: int, threads: int) -> Generator[Attempt]:
    first = list(islice(numbers, 1))  # before anything is made: there may be nothing to do
    if not first:
        return
    copies = min(copies, len(evaluation.numbers))
    envs = make_vec(evaluation.setup, copies=copies, threads=threads, autoreset="Disabled")
    try:
        agent = PolicyAgent.load(evaluation.agent, envs)
        yield from run_batch(envs, agent, chain(first, numbers), evaluation.seed_of)
    finally:
        envs.close()


class TrainingEvaluator:
    """Evaluates the policy of a training on episodes that it never learns from, and films one of them.

    It has copies of its own and draws no random number that training draws from.
    """

    def __init__(self, training: Training, agent: Agent, *, threads: int = 0) -> None:
        """Make the copies.

        Args:
            training: The training, whose evaluations have episodes.
            agent: Its policy, which acts in a batch and alone, as `PolicyAgent`.
            threads: Threads for physics and drawing, 0 for one per CPU.
        """
        self._training, self._agent = training, agent
        copies = min(training.copies, training.episodes)
        self._envs = make_vec(training.evaluation_setup, copies=copies, threads=threads, autoreset="Disabled")
        self._film: Film | None = None
        self._film_env = None

    def attempts(self) -> Iterator[Attempt]:
        """Run the episodes and yield each as it ends."""
        first = self._training.first_selection_seed
        return run_batch(self._envs, self._agent, range(self._training.episodes), lambda number: first + number)

    def film(self, path: Path) -> str:
        """Film the first of the episodes; return why that is impossible, where nothing can draw, or nothing."""
        try:
            if self._film is None or self._film_env is None:
                self._film_env = make(self._training.evaluation_setup)
                self._film = Film(self._film_env)
            with self._film.into(path):
                run_episode(self._film_env, self._agent, seed=self._training.first_selection_seed)
        except MissingDependency as err:
            return str(err)
        return ""

    def close(self) -> None:
        """Close the copies. Closing twice is harmless."""
        for_all([one.close for one in (self._film, self._film_env, self._envs) if one is not None])


def score_of(attempts: list[Attempt]) -> Score:
    """Return the score of a policy.

    Args:
        attempts: Its episodes, at least one, in any order.
    """
    results = [attempt.result for attempt in sorted(attempts, key=lambda attempt: attempt.number)]
    return Score(
        episodes=len(results),
        successes=sum(bool(result.success) for result in results),
        judged=sum(result.success is not None for result in results),
        reward=sum(result.reward for result in results) / len(results),
        length=sum(result.steps for result in results) / len(results),
    )
