"""Evaluates a policy between updates, on episodes that training never sees, and films one of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rcs.agents import Agent
from rcs.envs.step.stack import for_all
from rcs.errors import MissingDependency
from rcs.rl.checkpoint import Score
from rcs.rl.training import Training
from rcs.rollout.batch import run_batch
from rcs.rollout.collect import Attempt
from rcs.rollout.episode import EpisodeResult, run_episode
from rcs.rollout.video import Film
from rcs.setups.make import make, make_vec

VIDEOS = "videos"


class Examiner:
    """Has copies of an environment of its own. It draws no random numbers that training draws from."""

    def __init__(self, training: Training, agent: Agent, *, threads: int = 0) -> None:
        """Make the copies.

        Args:
            training: Whose policy is evaluated.
            agent: Acts in a batch and alone, as `PolicyAgent`.
            threads: Threads for physics and drawing, 0 for one per CPU.
        """
        self._training = training
        self._agent = agent
        copies = max(min(training.copies, training.episodes), 1)
        self._envs = make_vec(training.evaluation_setup, copies=copies, threads=threads, autoreset="Disabled")
        self._film_env = None
        self._film: Film | None = None
        self.cannot_film = ""
        """Why there are no videos, where nothing can draw."""

    def examine(self) -> Iterator[Attempt]:
        """Run the episodes and yield each as it ends."""
        first = self._training.first_selection_seed
        return run_batch(self._envs, self._agent, range(self._training.episodes), lambda number: first + number)

    def film(self, path: Path) -> EpisodeResult | None:
        """Film the first of the episodes; without OpenGL, say so in `cannot_film`, once."""
        if self.cannot_film:
            return None
        try:
            if self._film is None:
                self._film_env = make(self._training.evaluation_setup)
                self._film = Film(self._film_env)
            assert self._film_env is not None
            with self._film.into(path):
                return run_episode(self._film_env, self._agent, seed=self._training.first_selection_seed)
        except MissingDependency as err:
            self.cannot_film = str(err)
            return None

    def close(self) -> None:
        """Close the copies. Closing twice is harmless."""
        film = [] if self._film is None else [self._film.close]
        env = [] if self._film_env is None else [self._film_env.close]
        for_all([*film, *env, self._envs.close])


def score_of(attempts: list[Attempt]) -> Score:
    """Return how a policy did.

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
