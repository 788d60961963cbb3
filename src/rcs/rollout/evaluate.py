"""Measures how often an agent succeeds in seeded episodes, in one process or several, with videos."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rcs.agents import Agent, agent_for
from rcs.data.verdicts import wilson_interval
from rcs.envs.env import Env
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.rollout.collect import Attempt, seed_of
from rcs.rollout.episode import EpisodeResult, Judge, run_episode
from rcs.rollout.pool import WorkerPool
from rcs.rollout.video import Video
from rcs.setups.make import make


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """What to evaluate."""

    setup: Setup
    agent: Any = None
    """An agent's class or name, `module:Class`; None for the expert of the task."""
    episodes: int = 50
    seed: int = 0
    """Same seed, same episodes; different seeds share none."""
    workers: int = 1
    """Processes; one works in this process."""
    videos: Path | None = None
    """Folder for the videos of the first episodes; None for no videos."""
    video_episodes: int = 10
    """Number of episodes with a video."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: A number is not valid.
        """
        for name, least in (("episodes", 1), ("seed", 0), ("workers", 1), ("video_episodes", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise InvalidSetup(f"{name} is {value!r}; valid is a whole number from {least}.")


@dataclass(kw_only=True)
class Summary:
    """The results of an evaluation."""

    results: list[EpisodeResult] = field(default_factory=list[EpisodeResult])

    @property
    def judged(self) -> int:
        """Episodes with a verdict."""
        return sum(result.success is not None for result in self.results)

    @property
    def successes(self) -> int:
        """Episodes in which the task was done."""
        return sum(bool(result.success) for result in self.results)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % Wilson interval of the success rate, 0 … 1."""
        return wilson_interval(self.successes, self.judged)

    @property
    def failures(self) -> Counter[str]:
        """Number of failures by class."""
        return Counter(str(result.failure) for result in self.results if not result.success)

    def to_json(self) -> dict[str, Any]:
        """Return the figures as JSON values."""
        low, high = self.interval
        return {
            "episodes": len(self.results),
            "judged": self.judged,
            "successes": self.successes,
            "success_rate": self.successes / self.judged if self.judged else None,
            "wilson_95": [low, high],
            "failures": dict(self.failures),
            "mean_steps": sum(result.steps for result in self.results) / max(len(self.results), 1),
        }

    def write(self, path: Path, evaluation: Evaluation) -> None:
        """Write the evaluation and its figures to a JSON file."""
        agent = evaluation.agent if isinstance(evaluation.agent, str | None) else evaluation.agent.__qualname__
        about = {"setup": evaluation.setup.to_json(), "agent": agent, "seed": evaluation.seed}
        path.write_text(json.dumps({**about, **self.to_json()}, indent=2) + "\n", "utf-8")


class Evaluator:
    """Runs episodes: one process of an evaluation."""

    def __init__(self, evaluation: Evaluation, env: Env | None = None, judge: Judge | None = None) -> None:
        """Make the environment and the agent."""
        self._evaluation = evaluation
        has_videos = evaluation.videos is not None and evaluation.video_episodes > 0
        self._env = env or make(evaluation.setup, render_mode="rgb_array" if has_videos else None)
        self._agent: Agent = agent_for(self._env, evaluation.agent)
        self._judge = judge

    def attempt(self, number: int) -> Attempt:
        """Run one episode."""
        evaluation = self._evaluation
        video: Video | None = None
        if evaluation.videos is not None and number < evaluation.video_episodes:
            video = Video(evaluation.videos / f"{number:06d}.mp4", rate=self._env.frequency)
        try:
            result = run_episode(
                self._env,
                self._agent,
                seed=seed_of(evaluation.seed, number),
                judge=self._judge,
                on_step=None if video is None else lambda: video.add(self._env.render()),
            )
        finally:
            if video is not None:
                video.close()
        return Attempt(number=number, result=result)

    def close(self) -> None:
        """Close agent and environment."""
        try:
            self._agent.close()
        finally:
            self._env.close()


@dataclass(frozen=True)
class _Work:
    """Makes the worker in its process; sent to it once."""

    evaluation: Evaluation

    def __call__(self) -> Evaluator:
        return Evaluator(self.evaluation)


def evaluate(
    evaluation: Evaluation, summary: Summary | None = None, *, env: Env | None = None, judge: Judge | None = None
) -> Iterator[Attempt]:
    """Run the episodes and yield each as it ends; `summary` is updated.

    Args:
        evaluation: What to evaluate.
        summary: Takes the results.
        env: An environment to use in this process; None for a new one. It is closed at the end.
        judge: Judges episodes instead of the task; only in this process.

    Raises:
        InvalidSetup: The setup is not valid, or there is no agent for the task.
    """
    summary = Summary() if summary is None else summary
    if evaluation.workers == 1 or env is not None or judge is not None:
        evaluator = Evaluator(evaluation, env, judge)
        try:
            for number in range(evaluation.episodes):
                attempt = evaluator.attempt(number)
                summary.results.append(attempt.result)
                yield attempt
        finally:
            evaluator.close()
        return
    with WorkerPool(_Work(evaluation), evaluation.workers) as pool:
        for attempt in pool.map(iter(range(evaluation.episodes))):
            summary.results.append(attempt.result)
            yield attempt
