"""Measures how often an agent succeeds in seeded episodes, in one process, several, or on a cluster, with videos."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from rcs_data.verdicts import wilson_interval

from rcs.agents import Agent, agent_for
from rcs.devices import lookup
from rcs.envs.env import Env
from rcs.envs.observers.dataset_info import versions
from rcs.envs.observers.recorder import Recorder
from rcs.envs.setup import Setup
from rcs.envs.step.stack import for_all
from rcs.errors import InvalidSetup
from rcs.rollout.cluster import LOCAL
from rcs.rollout.collect import Attempt, episode_id, seed_of
from rcs.rollout.episode import EpisodeResult, Judge, run_episode
from rcs.rollout.pool import WorkerPool
from rcs.rollout.ray_pool import ClusterUsage, RayPool
from rcs.rollout.remote_files import FileWorker, SentAgent, write_files
from rcs.rollout.video import Film
from rcs.setups.make import make

UNSEEN = 1 << 60
"""First seed of a range of its own: collections and `rcs eval` have those below 2**32, training those from 2**61 on."""


@runtime_checkable
class Named(Protocol):
    """A factory of agents with a name of its own, such as the address of a policy."""

    name: str

    def __call__(self, env: Env) -> Agent:
        """Return an agent for an environment."""
        ...


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The recipe of an evaluation."""

    setup: Setup
    agent: Any = None
    """An agent's class or name, `module:Class`, the address of a policy, or a `Named`; None for the expert of the task.
    In one process also an agent."""
    episodes: int = 50
    seed: int = 0
    """Same seed, same episodes; different seeds share none."""
    first_seed: int = 0
    """Added to the seed of every episode: `UNSEEN` for episodes that no collection and no training has, 0 for those of
    the collection with this seed."""
    workers: int = 1
    """Processes; one works in this process. With `ray`, 0 is one per CPU of the cluster."""
    ray: str | None = None
    """Address of a Ray cluster for the processes (`local` for one of this machine, `auto`, `host:port`); None for this
    machine, without Ray."""
    videos: int = 0
    """Number of first episodes with a video, `<number>.mp4`."""
    out: Path = Path("evaluation")
    """Folder for videos and figures."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: A number is not valid.
        """
        fewest = 1 if self.ray in (None, LOCAL) else 0
        for name, least in (("episodes", 1), ("seed", 0), ("first_seed", 0), ("workers", fewest), ("videos", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise InvalidSetup(f"{name} is {value!r}; valid is a whole number from {least}.")

    @property
    def agent_name(self) -> str | None:
        """Name of the agent; None for the expert of the task."""
        agent = type(self.agent) if isinstance(self.agent, Agent) else self.agent
        if isinstance(agent, Named):
            return agent.name
        return None if agent is None else lookup.name_of("agent", agent)

    def seed_of(self, number: int) -> int:
        """Return the seed of an episode."""
        return self.first_seed + seed_of(self.seed, number)


@dataclass(kw_only=True)
class Summary:
    """Results of an evaluation or a collection."""

    attempts: list[Attempt] = field(default_factory=list[Attempt])
    """Attempts in the order of their ends."""
    cluster: ClusterUsage | None = None
    """The workers; None without a cluster."""
    is_interrupted: bool = False
    """Set it to end the evaluation after the running episodes."""

    @property
    def results(self) -> list[EpisodeResult]:
        """The results, in the order of the attempts' numbers."""
        return [attempt.result for attempt in sorted(self.attempts, key=lambda attempt: attempt.number)]

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
        """The 95 % Wilson interval of the success rate, 0 … 1; all of it if nothing was judged."""
        return wilson_interval(self.successes, self.judged)

    @property
    def failures(self) -> Counter[str]:
        """Number of failures by class."""
        return Counter(result.failure for result in self.results if result.failure is not None)

    def to_json(self) -> dict[str, Any]:
        """Return the figures as JSON values: of all, and of each episode."""
        return {
            "episodes": len(self.results),
            "judged": self.judged,
            "successes": self.successes,
            "success_rate": self.successes / self.judged if self.judged else None,
            "wilson_95": list(self.interval),
            "failures": dict(sorted(self.failures.items())),
            "mean_steps": sum(result.steps for result in self.results) / max(len(self.results), 1),
            "results": [asdict(result) for result in self.results],
        }

    def write(self, evaluation: Evaluation, more: Mapping[str, Any] | None = None) -> Path:
        """Write recipe and figures to `evaluation.json` in the folder of an evaluation, and return the file's path.

        Args:
            evaluation: What was evaluated.
            more: Further JSON values for the file.
        """
        about = {"setup": evaluation.setup.to_json(), "agent": evaluation.agent_name}
        about |= {"seed": evaluation.seed, "first_seed": evaluation.first_seed}
        path = evaluation.out / "evaluation.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(
            json.dumps({**about, **(more or {}), **self.to_json(), "versions": versions()}, indent=2) + "\n", "utf-8"
        )
        return path


class Evaluator:
    """Runs episodes: one process of an evaluation."""

    def __init__(
        self,
        evaluation: Evaluation,
        env: Env | None = None,
        judge: Judge | None = None,
        recorder: Recorder | None = None,
    ) -> None:
        """Make the environment and the agent.

        Raises:
            InvalidSetup: The setup makes no sense, there is no such agent, or no picture for a video.
        """
        self._evaluation = evaluation
        self._judge = judge
        self._recorder = recorder
        self._env = env or make(evaluation.setup)
        try:
            self._film = Film(self._env) if evaluation.videos else None
            self._agent: Agent = agent_for(self._env, evaluation.agent)
        except BaseException:
            self._env.close()
            raise

    def attempt(self, number: int) -> Attempt:
        """Run one episode."""
        film, is_filmed = self._film, number < self._evaluation.videos
        with (
            film.into(self._evaluation.out / f"{number:06d}.mp4") if film is not None and is_filmed else nullcontext(),
            nullcontext() if self._recorder is None else self._recorder.discard_on_error(),
        ):
            return Attempt(number=number, result=self._run(number))

    def _run(self, number: int) -> EpisodeResult:
        if self._recorder is not None:
            self._recorder.name_next(episode_id(number))
        seed = self._evaluation.seed_of(number)
        result = run_episode(self._env, self._agent, seed=seed, judge=self._judge)
        if self._recorder is not None:
            self._recorder.finish(result.success, {"attempt": number, **result.outcome()})
        return result

    def close(self) -> None:
        """Close agent, film and environment, whatever fails."""
        for_all([self._agent.close, *([] if self._film is None else [self._film.close]), self._env.close])


def _remote_worker(evaluation: Evaluation, agent: SentAgent, folder: Path) -> Evaluator:
    """Return a worker on another machine."""
    return Evaluator(replace(evaluation, agent=agent.unpack(folder / "agent"), out=folder / "videos"))


def evaluate(
    evaluation: Evaluation | Setup | str,
    summary: Summary | None = None,
    *,
    env: Env | None = None,
    judge: Judge | None = None,
    recorder: Recorder | None = None,
) -> Iterator[Attempt]:
    """Run the episodes, and yield each as it ends.

    Closing the iterator, or setting `summary.is_interrupted`, ends the evaluation after the running episodes.

    Args:
        evaluation: Setup, agent and number of episodes; a setup or the name of a task for 50 episodes of its expert.
        summary: Collects the attempts.
        env: An environment of the evaluation's setup, simulated or real, to use in this process; None for a new one.
            It is closed at the end.
        judge: Returns whether an episode was a success, in the place of the task; all episodes are then in this
            process.
        recorder: Records every episode; `env` is given too, and it is one of its observers.

    Raises:
        InvalidSetup: The setup is not valid, there is no such agent, or real devices alone have no picture to film.
        RcsError: A worker process died, or the cluster cannot be reached.
    """
    if not isinstance(evaluation, Evaluation):
        evaluation = Evaluation(setup=evaluation if isinstance(evaluation, Setup) else Setup(evaluation))
    summary = Summary() if summary is None else summary
    numbers = _numbers(evaluation, summary)
    if (evaluation.workers == 1 and evaluation.ray is None) or env is not None or judge is not None:
        evaluator = Evaluator(evaluation, env, judge, recorder)
        try:
            for number in numbers:
                summary.attempts.append(evaluator.attempt(number))
                yield summary.attempts[-1]
        except BaseException as error:
            try:
                evaluator.close()
            except Exception as err:  # noqa: BLE001  the first error is the one to be raised
                error.add_note(f"While closing: {type(err).__name__}: {err}")
            raise
        evaluator.close()
        return
    for attempt in _attempts(evaluation, numbers, summary):
        summary.attempts.append(attempt)
        yield attempt


def _attempts(evaluation: Evaluation, numbers: Iterator[int], summary: Summary) -> Iterator[Attempt]:
    if evaluation.ray is None:
        with WorkerPool(partial(Evaluator, evaluation), evaluation.workers) as pool:
            yield from pool.map(numbers)
        return
    worker = partial(_remote_worker, evaluation, SentAgent.of(evaluation.agent))
    make = partial(FileWorker, worker, outbox="videos")
    with RayPool(make, evaluation.workers, evaluation.ray) as pool:
        summary.cluster = pool.usage
        for attempt, files in pool.map(numbers):
            write_files(files, evaluation.out)
            yield attempt


def _numbers(evaluation: Evaluation, summary: Summary) -> Iterator[int]:
    for number in range(evaluation.episodes):
        if summary.is_interrupted:
            return
        yield number
