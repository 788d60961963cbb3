"""Training: updates, evaluations and checkpoints, from the start or from where a kill left off.

A run that is killed at any moment goes on from its last checkpoint and ends with the weights, bit for bit, of one that
was not: checkpoints lie between updates, have all that decides what follows, and appear whole or not at all. An
evaluation changes nothing that training depends on.
"""

from __future__ import annotations

import importlib.metadata
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from rcs.envs.observers.recorder import versions
from rcs.envs.step.stack import for_all
from rcs.errors import CorruptCheckpoint, InvalidSetup
from rcs.rl.checkpoint import (
    REPLAY,
    Checkpoint,
    Score,
    best_of,
    checkpoints_of,
    open_checkpoint,
    remove_old,
    write_checkpoint,
)
from rcs.rl.examiner import VIDEOS, Examiner, score_of
from rcs.rl.learners import copies_for, flat_for, learner_for
from rcs.rl.metrics import EPISODES, JUDGED, LENGTH, RATE, REWARD, SPEED, SUCCESSES, Metrics
from rcs.rl.networks import mean_action
from rcs.rl.packages import package, require_device
from rcs.rl.policy import PolicyAgent
from rcs.rl.run import agreed, lock_run, write_training
from rcs.rl.threads import measure_physics, measure_torch
from rcs.rl.training import Training
from rcs.rollout.collect import Attempt
from rcs.setups.make import resolve
from rcs.tasks.free import Free

_ROWS = 200
"""About so many rows of figures has a whole training."""


@dataclass(kw_only=True)
class Progress:
    """The progress of a training; who reads it may set `is_interrupted`."""

    steps: int = 0
    """Environment steps so far, of all copies together."""
    total: int = 0
    """Steps of the whole training."""
    seconds: float = 0.0
    """How long training took so far, with the time before kills that is not repeated [s]."""
    speed: float = 0.0
    """Steps per second while learning, without evaluations, since the last row of figures."""
    score: Score | None = None
    """The last evaluation."""
    best: Checkpoint | None = None
    """The checkpoint that did best."""
    doing: str = "preparing"
    """What is being done."""
    notes: list[str] = field(default_factory=list[str])
    """What a person should know: what was measured, where it goes on, what was damaged."""
    is_interrupted: bool = False
    """Set it to end after the update at work, with a checkpoint."""


def train(
    training: Training, out: str | Path, progress: Progress | None = None, *, threads: int = 0, videos: bool = True
) -> Iterator[Progress]:
    """Train until all steps are made, and yield after every update and every episode of an evaluation.

    If there is a run of the same training in the folder, it goes on from the newest checkpoint that is not damaged.
    Closing the iterator ends the training as a kill does; `progress.is_interrupted` ends it with a checkpoint.

    Args:
        training: What to train.
        out: The run's folder; `checkpoint.py` says what is in it.
        progress: Updated while it runs.
        threads: Threads for physics and drawing; 0 to measure which number is fastest. They change no result.
        videos: Whether each evaluation films an episode.

    Raises:
        MissingDependency: The extra `rl` is not installed.
        InvalidSetup: The setup makes no sense, or the folder has a run of another training.
        DatasetError: The folder has other things in it, another process trains there, or the disk fails.
    """
    progress = Progress() if progress is None else progress
    require_trainable(training)
    run = Path(out)
    with lock_run(run):
        yield from _Run(run, agreed(run, training), progress, threads, videos).go_on()


def require_trainable(training: Training) -> None:
    """Refuse what cannot be trained here, as far as that can be known without building the environment.

    Raises:
        MissingDependency: The extra `rl` is not installed.
        InvalidSetup: The setup names what is not there or does not fit, its task has no reward, or torch cannot use the
            device.
    """
    for name in ("torch", "stable_baselines3", "tensorboard"):
        package(name)
    if isinstance(resolve(training.setup).task, Free):
        raise InvalidSetup("Free has no reward, so there is nothing to learn; train a task such as PickCuboid.")
    require_device(training.device)


class _Run:
    """One process of a training."""

    def __init__(self, run: Path, training: Training, progress: Progress, threads: int, videos: bool) -> None:
        self._run, self._progress, self._videos = run, progress, videos
        progress.total = training.steps
        if not threads:
            measured = measure_physics(training)
            progress.notes.append(str(measured))
            threads = measured.chosen
        self._envs = copies_for(training, threads=threads)
        self._examiner: Examiner | None = None
        try:
            flat = flat_for(training, self._envs)
            if not training.torch_threads:
                measured = measure_torch(training, flat)
                progress.notes.append(str(measured))
                training = replace(training, torch_threads=measured.chosen)
            self._training = training
            package("torch").set_num_threads(training.torch_threads)
            self._learner = learner_for(training, self._envs, flat)
            self._agent = PolicyAgent(mean_action(self._learner.policy), flat.layout)
            self._last = self._restore()
            write_training(run, training)  # only now, so that what was refused is in nobody's way
            self._threads, self._learning, self._made = threads, 0.0, 0
        except BaseException:
            self._envs.close()
            raise
        self._started = time.perf_counter() - (self._last.seconds if self._last is not None else 0.0)

    def _restore(self) -> Checkpoint | None:
        """Go on from the newest checkpoint that is not damaged, and return it; None to start from the beginning.

        Raises:
            CorruptCheckpoint: There are checkpoints, and all from which one could go on are damaged.
        """
        damage = ""
        for place in reversed(checkpoints_of(self._run)):
            try:
                checkpoint = open_checkpoint(place)
                if not checkpoint.can_be_resumed:
                    continue
                weights, state = checkpoint.policy(), checkpoint.learner()
                pieces = checkpoint.replay()
            except CorruptCheckpoint as err:
                damage = str(err)
                self._progress.notes.append(f"{err} The one before is tried.")
                continue
            self._learner.load(weights, state)
            if self._learner.has_replay:
                self._learner.load_replay(pieces)
            if checkpoint.steps < self._training.steps:
                self._progress.notes.append(f"Going on from step {checkpoint.steps}.")
            return checkpoint
        if damage:
            raise CorruptCheckpoint(
                f"No checkpoint of {self._run} is left to go on from: {damage} Train into another folder; what acts in "
                "the checkpoints that are whole still can be evaluated."
            )
        return None

    def go_on(self) -> Iterator[Progress]:
        """Train; see `train`."""
        progress, learner, training = self._progress, self._learner, self._training
        begun = -1 if self._last is None else self._last.steps
        try:
            remove_old(self._run, keep_after=begun)
            scored = [one for one in map(open_checkpoint, checkpoints_of(self._run)) if one.score is not None]
            progress.best, progress.score = best_of(scored), scored[-1].score if scored else None
            with Metrics(self._run, after=begun) as self._metrics:
                if self._last is None:
                    yield from self._evaluate_and_save()
                while not learner.is_done and not progress.is_interrupted:
                    before = learner.steps
                    self._advance()
                    yield progress
                    if learner.is_done or _passes(before, learner.steps, training.evaluate_every):
                        yield from self._evaluate_and_save()
                    elif _passes(before, learner.steps, training.checkpoint_every):
                        self._save(None)
                if self._last is not None and self._last.steps < learner.steps:
                    self._save(None)
            self._tell("done" if learner.is_done else "interrupted")
            yield progress
        finally:
            self.close()

    def _advance(self) -> None:
        """Make an update, and note its figures now and then."""
        learner, start, before = self._learner, time.perf_counter(), self._learner.steps
        learner.advance()
        self._learning += time.perf_counter() - start
        self._made += learner.steps - before
        self._progress.speed = self._made / self._learning
        self._tell("learning")
        if _passes(before, learner.steps, max(self._training.steps // _ROWS, 1)):
            self._note()

    def _note(self) -> None:
        """Write the figures of the last update."""
        figures = {**self._learner.figures(), SPEED: self._progress.speed}
        self._metrics.add(self._learner.steps, self._seconds(), figures)
        self._learning, self._made = 0.0, 0  # the speed is that since the last row

    def _tell(self, doing: str) -> None:
        progress = self._progress
        progress.doing, progress.steps, progress.seconds = doing, self._learner.steps, self._seconds()

    def _evaluate_and_save(self) -> Iterator[Progress]:
        """Evaluate the policy and write its checkpoint."""
        progress, training = self._progress, self._training
        self._tell("evaluating")
        if not training.episodes:
            self._save(None)
            return
        if self._examiner is None:
            self._examiner = Examiner(training, self._agent, threads=self._threads)
        attempts: list[Attempt] = []
        for attempt in self._examiner.examine():
            attempts.append(attempt)
            yield progress
        score = progress.score = score_of(attempts)
        if self._videos:
            self._examiner.film(self._run / VIDEOS / f"{self._learner.steps:09d}.mp4")
            if self._examiner.cannot_film:
                progress.notes.append(f"No videos: {self._examiner.cannot_film}")
                self._videos = False
        figures: dict[str, float] = {
            EPISODES: score.episodes,
            SUCCESSES: score.successes,
            JUDGED: score.judged,
            REWARD: score.reward,
            LENGTH: score.length,
        }
        if score.judged:
            figures[RATE] = score.successes / score.judged
        self._metrics.add(self._learner.steps, self._seconds(), figures)
        self._save(score)

    def _save(self, score: Score | None) -> None:
        learner, last = self._learner, self._last
        if learner.has_figures:
            self._note()  # what is noted later must not be missing after a kill
        self._metrics.sync()
        files: dict[str, str] = {}
        piece = None
        if learner.has_replay:
            earlier = {} if last is None else last.files
            files = {name: digest for name, digest in earlier.items() if name.startswith(f"{REPLAY}/")}
            piece = learner.replay_piece(0 if last is None else last.steps // self._training.copies)
        about = Checkpoint(
            path=self._run,
            training=self._training,
            steps=learner.steps,
            seconds=self._seconds(),
            layout=self._agent.flat.layout,
            score=score,
            versions=_versions(),
            files=files,
        )
        made = self._last = write_checkpoint(
            self._run, about, policy=learner.weights(), learner=learner.state(), piece=piece
        )
        remove_old(self._run)
        self._progress.best = best_of([one for one in (self._progress.best, made) if one is not None])

    def _seconds(self) -> float:
        return time.perf_counter() - self._started

    def close(self) -> None:
        """Close all copies."""
        for_all([self._envs.close, *([] if self._examiner is None else [self._examiner.close])])


def _passes(before: int, after: int, every: int) -> bool:
    return before // every != after // every


def _versions() -> dict[str, str]:
    return {**versions(), **{name: importlib.metadata.version(name) for name in ("torch", "stable-baselines3")}}
