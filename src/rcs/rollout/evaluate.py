"""Measures how often an agent succeeds in seeded episodes, in one process, several, or on a cluster, with films."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, nullcontext
from dataclasses import fields, replace
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any

from rcs_data.ledger import Ledger, Row
from rcs_data.ledger.ledger import FILMS_FOLDER

from rcs.agents import Agent, agent_for
from rcs.agents.identity import identity_of
from rcs.envs.env import Env
from rcs.envs.observers.recorder import Recorder
from rcs.envs.setup import Setup
from rcs.envs.step.stack import for_all
from rcs.errors import InvalidSetup, RcsError
from rcs.rollout.collection import Attempt, episode_id
from rcs.rollout.episode import SIMULATOR, Answer, EpisodeResult, Judge, run_episode
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.logbook import Logbook, condition_of, differs
from rcs.rollout.person import PersonJudge
from rcs.rollout.pool import WorkerPool
from rcs.rollout.ray_pool import RayPool, write_files
from rcs.rollout.video import Film, new_film
from rcs.setups.resolve import with_camera_names

Write = Callable[[Attempt], None]
"""Writes the result of an episode into a ledger."""


class Evaluator:
    """Runs episodes: one process of an evaluation."""

    def __init__(
        self,
        evaluation: Evaluation,
        condition: str = "",
        *,
        films: Path | None = None,
        env: Env | None = None,
        judge: Judge | None = None,
        recorder: Recorder | None = None,
        keeps_env: bool = False,
    ) -> None:
        """Make the environment and the agent.

        Args:
            evaluation: The evaluation.
            condition: The hash of its condition, for names of films and recordings.
            films: Folder for a film of every episode; None for none.
            env: The environment; None for a new one.
            judge: Returns whether an episode was a success, in the place of the task.
            recorder: Records every episode.
            keeps_env: Whether the environment stays open.

        Raises:
            InvalidSetup: The setup makes no sense, or is not that of the environment, there is no such agent, or no
                picture for a film.
        """
        self._evaluation, self._keeps_env = evaluation, keeps_env
        self.condition = condition
        """The hash of the condition."""
        self._films, self._judge, self._recorder = films, judge, recorder
        self._env = env or evaluation.make()
        try:
            if env is not None and env.has_setup:
                _require_same_setup(evaluation.setup, env)
            self._film = None if films is None else Film(self._env)
            self._agent: Agent = agent_for(self._env, evaluation.agent)
        except BaseException:
            if not keeps_env:
                self._env.close()
            raise

    def attempt(self, number: int) -> Attempt:
        """Run one episode; if it is recorded, `keep` it then."""
        if self._film is None or self._films is None:
            return self._attempt(number)
        name = self._evaluation.name_of(self.condition, number)
        with new_film(self._films / f"{name}.mp4") as draft, self._film.into(draft):
            return self._attempt(number)

    def _attempt(self, number: int) -> Attempt:
        began = time.perf_counter()
        with nullcontext() if self._recorder is None else self._recorder.discard_on_error():
            if self._recorder is not None:
                name = f"{episode_id(number)}-{self._evaluation.name_of(self.condition, number)}"  # readers sort by it
                self._recorder.name_next(self._recorder.free_name(name))
            result = run_episode(self._env, self._agent, seed=self._evaluation.seed_of(number), judge=self._judge)
        return Attempt(
            number=number,
            result=result,
            weights=self._agent.weights,
            is_lost=self._agent.is_lost,
            latencies=tuple(self._agent.latencies),
            seconds=time.perf_counter() - began,
        )

    def keep(self, attempt: Attempt, write: Write | None) -> None:
        """Write the result of the last episode, then keep its recording; a lost policy in simulation leaves none.

        The order matters: a recording takes a while to be finished, in which a kill would lose a person's answer.

        Args:
            attempt: The episode.
            write: Writes its row; there is no recording of an episode that it refuses. None without a ledger.

        Raises:
            RcsError: The row is refused: the policy was lost, or its weights changed.
            DatasetError: The disk of the ledger fails; the recording is kept.
        """
        recorder, result = self._recorder, attempt.result
        try:
            if write is not None:
                write(attempt)
        except BaseException as err:
            if recorder is not None and recorder.is_recording:
                if type(err) is RcsError:
                    recorder.discard()
                else:
                    self._finish(recorder, attempt)
            raise
        if recorder is None:
            return
        is_simulated = set(self._env.platform.values()) <= {"simulation"}
        if result.failure == SIMULATOR and not recorder.is_recording:
            recorder.forget_next()
        elif attempt.is_lost and is_simulated:
            recorder.discard()
        else:
            self._finish(recorder, attempt)

    @staticmethod
    def _finish(recorder: Recorder, attempt: Attempt) -> None:
        recorder.finish(attempt.result.success, {"attempt": attempt.number, **attempt.result.outcome()})

    def close(self) -> None:
        """Close agent, film and environment, whatever fails."""
        film, env = [] if self._film is None else [self._film.close], [] if self._keeps_env else [self._env.close]
        for_all([self._agent.close, *film, *env])


Attempts = Generator[Attempt]
"""Attempts, each made when it is requested."""
Maker = Callable[[Evaluation, Iterator[int]], Attempts]
"""Runs the episodes with the numbers, which are taken when there is room, and yields each attempt as it ends."""


def evaluate(
    evaluation: Evaluation | Setup | str,
    summary: Summary | None = None,
    *,
    env: Env | None = None,
    judge: Judge | None = None,
    recorder: Recorder | None = None,
    maker: Maker | None = None,
) -> Iterator[Attempt]:
    """Run the episodes that are not in the ledger yet, and yield each as it ends.

    Closing the iterator, or setting `summary.is_interrupted`, ends the evaluation after the running episodes.

    Args:
        evaluation: Setup, agent and number of episodes; a setup or the name of a task for 50 episodes of its expert.
        summary: Collects the attempts, those that are in the ledger already among them.
        env: An environment of the evaluation's setup, simulated or real, to use in this process; None for a new one.
            It is closed at the end.
        judge: Returns whether an episode was a success, in the place of the task; all episodes are then in this
            process.
        recorder: Records every episode; `env` is given too, and it is one of its observers.
        maker: Runs the episodes; None for this process, workers or a cluster, as the evaluation says.

    Raises:
        InvalidSetup: The setup is not valid, or not that of the environment, or there is no such agent.
        DatasetError: The folder has something else than a ledger, or the disk fails.
        RcsError: A worker process died, the cluster or the policy cannot be reached, or the weights changed.
    """
    if not isinstance(evaluation, Evaluation):
        evaluation = Evaluation(setup=evaluation if isinstance(evaluation, Setup) else Setup(evaluation))
    summary = Summary() if summary is None else summary
    summary.episodes = evaluation.episodes
    try:
        book = None if evaluation.out is None else _logbook(evaluation, summary, env, judge)
    except BaseException:
        if env is not None:
            env.close()
        raise
    with nullcontext() if book is None else book:
        numbers: Iterator[int] = takewhile(lambda _: not summary.is_interrupted, evaluation.numbers)
        if book is not None:
            book.take(summary)
            numbers = book.missing(summary)
        if isinstance(judge, PersonJudge):
            numbers = _announced(evaluation, summary, numbers, judge, book, env)
        is_alone = (evaluation.workers == 1 and evaluation.ray is None) or env is not None or judge is not None
        is_here = maker is None and is_alone
        if maker is not None:
            making = maker(evaluation, numbers)
        elif is_here:
            hash_ = "" if book is None else book.hash
            write: Write | None = None if book is None else book.add
            making = _here(evaluation, numbers, hash_, write, env=env, judge=judge, recorder=recorder)
        else:
            making = _elsewhere(evaluation, numbers)
        with closing(making):
            for attempt in making:
                if book is not None and not is_here:
                    book.add(attempt)
                summary.attempts.append(attempt)
                if isinstance(judge, PersonJudge):
                    judge.answered(partial(correct, book, summary, len(summary.attempts) - 1))
                yield attempt
        if book is not None:
            book.take(summary)  # what other processes made
            summary.is_decided, summary.pairs = book.is_decided(summary), book.pairs


def film(evaluation: Evaluation, most: int) -> Iterator[tuple[Row, EpisodeResult]]:
    """Run episodes of an evaluation that has ended again from their seeds, and film them; failures come first.

    Yields the row of each, and its result now. If that differs (`logbook.differs`), because the policy or the
    environment draws numbers of its own or waits for the clock, the film shows another episode, and is removed.

    Args:
        evaluation: The evaluation, which has a folder.
        most: How many episodes shall have a film, with those that have one.

    Raises:
        InvalidSetup: There is no ledger, or real devices alone, which have no picture to film.
        RcsError: As `evaluate`.
    """
    with _logbook(evaluation, Summary(), None, None) as book:
        rows = {number: row for number in range(evaluation.episodes) if (row := book.row_of(number)) is not None}
        wanted = sorted(rows, key=lambda number: (rows[number].success is not False, number))[:most]
        wanted = [number for number in wanted if not book.ledger.film(rows[number]).is_file()]
        if not wanted:
            return
        folder = book.ledger.folder / FILMS_FOLDER
        folder.mkdir(exist_ok=True)
        # Processes that share an evaluation share its films, too.
        mine = (number for number in wanted if _is_to_be_filmed(book.ledger, rows[number]))
        if evaluation.workers == 1 and evaluation.ray is None:
            making = _here(evaluation, mine, book.hash, films=folder)
        else:
            making = _elsewhere(evaluation, mine, book.hash, films=folder)
        with closing(making):
            for attempt in making:
                row = rows[attempt.number]
                if differs(row, attempt.result):
                    book.ledger.film(row).unlink(missing_ok=True)
                yield row, attempt.result


def _is_to_be_filmed(ledger: Ledger, row: Row) -> bool:
    """Return whether an episode has no film, and nobody else makes one; it is then this process's own."""
    return ledger.claim(f"film of {row.name}") and not ledger.film(row).is_file()


def correct(book: Logbook | None, summary: Summary, place: int, answer: Answer) -> None:
    """Replace a judge's answer in the ledger and in a summary.

    Args:
        book: The ledger; None without one.
        summary: The summary.
        place: The place of the attempt in it.
        answer: The new answer.

    Raises:
        DatasetError: The disk is full or fails.
    """
    attempt = summary.attempts[place]
    if book is None:
        summary.attempts[place] = replace(attempt, result=attempt.result.corrected(answer))
    else:
        summary.attempts[place] = book.correct(attempt, answer)
        if summary.pairs is not None:  # the evaluation has ended
            summary.is_decided, summary.pairs = book.is_decided(summary), book.pairs


def _logbook(evaluation: Evaluation, summary: Summary, env: Env | None, judge: Judge | None) -> Logbook:
    identity = summary.identity = identity_of(evaluation.agent, evaluation.setup.task)
    condition = condition_of(evaluation, identity, env)
    summary.condition = condition.hash
    return Logbook(evaluation, identity, condition, "task" if judge is None else "person")


def _announced(
    evaluation: Evaluation,
    summary: Summary,
    numbers: Iterator[int],
    judge: PersonJudge,
    book: Logbook | None,
    env: Env | None,
) -> Iterator[int]:
    """Yield numbers, and have a person know which episode is to be prepared while the one before is judged."""
    for number in numbers:
        later = (one for one in evaluation.numbers[number + 1 :] if book is None or book.row_of(one) is None)
        coming = next(later, None)
        after = None if coming is None else evaluation.seed_of(coming)
        judge.announce(env, evaluation.seed_of(number), after)
        if summary.is_interrupted:  # while somebody prepared the episode
            return
        yield number


def _require_same_setup(setup: Setup, env: Env) -> None:
    """Check that an environment has the setup by which its episodes are known in a ledger.

    Raises:
        InvalidSetup: It has another one; the message has all differences.
    """
    own, wanted = env.setup, with_camera_names(setup)
    differences = [
        f"{name} is {getattr(own, name)!r}, not {getattr(wanted, name)!r}"
        for name in (one.name for one in fields(Setup))  # pyright: ignore[reportArgumentType]
        if getattr(own, name) != getattr(wanted, name)
    ]
    if differences:
        raise InvalidSetup(
            f"The environment has another setup than the evaluation: {'; '.join(differences)}. Evaluate with "
            "setup=env.setup, or make the environment of the evaluation's setup."
        )


def _here(
    evaluation: Evaluation, numbers: Iterator[int], condition: str, write: Write | None = None, **options: Any
) -> Attempts:
    """Run episodes in this process, and write them."""
    evaluator = Evaluator(evaluation, condition, **options)
    try:
        for number in numbers:
            attempt = evaluator.attempt(number)
            evaluator.keep(attempt, write)
            yield attempt
    except BaseException as error:
        try:
            evaluator.close()
        except Exception as err:  # noqa: BLE001  the first error is the one to be raised
            error.add_note(f"While closing: {type(err).__name__}: {err}")
        raise
    evaluator.close()


def _elsewhere(
    evaluation: Evaluation, numbers: Iterator[int], condition: str = "", films: Path | None = None
) -> Attempts:
    """Run episodes in processes of this machine, or on a cluster."""
    if evaluation.ray is None:
        with WorkerPool(partial(Evaluator, evaluation, condition, films=films), evaluation.workers) as pool:
            yield from pool.map(numbers)
        return
    make = partial(_remote_worker, evaluation, condition, films is not None)
    with RayPool(make, evaluation.workers, evaluation.ray, outbox=FILMS_FOLDER, agent=evaluation.agent) as pool:
        for attempt, files in pool.map(numbers):
            if films is not None:
                write_files(files, films)
            yield attempt


def _remote_worker(evaluation: Evaluation, condition: str, has_films: bool, folder: Path, agent: Any) -> Evaluator:
    """Return a worker on another machine."""
    return Evaluator(replace(evaluation, agent=agent), condition, films=folder / FILMS_FOLDER if has_films else None)
