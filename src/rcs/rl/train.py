"""Training: updates, evaluations and checkpoints, from the start or from where a kill left off.

A run that is killed at any moment continues from its last checkpoint and ends with the weights, bit for bit, of one
that was not: checkpoints lie between updates, have all that decides what follows, and appear whole or not at all. An
evaluation changes nothing that training depends on.
"""

from __future__ import annotations

import fcntl
import importlib.metadata
import os
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from rcs_data.files.durable import disk_errors, sync_folder, write_all
from rcs_data.files.lock import DatasetLock, try_lock

from rcs.envs.observers.dataset_info import versions
from rcs.envs.step.stack import for_all
from rcs.errors import CorruptCheckpoint, DatasetError, InvalidSetup
from rcs.extras import package_of
from rcs.rl.checkpoint import (
    CHECKPOINTS,
    LEARNER,
    REPLAY,
    VIDEOS,
    Checkpoint,
    Score,
    best_of,
    checkpoints_of,
    open_checkpoint,
    read_training,
    remove_old,
    whole_checkpoints,
    write_checkpoint,
)
from rcs.rl.dagger import DaggerLearner, teaching_setup
from rcs.rl.evaluate import TrainingEvaluator, score_of
from rcs.rl.learner import Learner, Sb3Learner
from rcs.rl.metrics import EPISODES, JUDGED, LENGTH, RATE, REWARD, SPEED, SUCCESSES, Metrics
from rcs.rl.networks import mean_action
from rcs.rl.policy import PolicyAgent
from rcs.rl.training import Dagger, Training
from rcs.rollout.collection import Attempt
from rcs.setups.make import make_vec, resolve
from rcs.tasks.free import Free

_LOCK = ".training.lock"
# These change neither the weights nor how they come about.
_FREE = ("evaluate_every", "episodes", "checkpoint_every")
_ROWS = 200
"""A whole training has about so many rows of figures."""


@dataclass(kw_only=True)
class TrainingProgress:
    """The progress of a training. Its reader may set `is_interrupted`."""

    steps: int = 0
    """Environment steps so far, of all copies together."""
    seconds: float = 0.0
    """Duration of the training so far, with the time before kills that is not repeated [s]."""
    speed: float = 0.0
    """Steps per second while learning, without evaluations, since the last row of figures."""
    score: Score | None = None
    """The last evaluation."""
    best: Checkpoint | None = None
    """The checkpoint with the best score."""
    doing: str = "preparing"
    """The present activity."""
    notes: list[str] = field(default_factory=list[str])
    """Messages for a person: where training continues, what is damaged."""
    is_interrupted: bool = False
    """Set it to end after the running update, with a checkpoint."""


def train(
    training: Training,
    out: str | Path,
    progress: TrainingProgress | None = None,
    *,
    threads: int = 0,
    videos: bool = True,
) -> Iterator[TrainingProgress]:
    """Train until all steps are made, and yield after every update and every episode of an evaluation.

    If there is a run of the same training in the folder, it continues from the newest checkpoint that is not damaged.
    Closing the iterator ends the training as a kill does; `progress.is_interrupted` ends it with a checkpoint.

    Args:
        training: The training to do.
        out: The run's folder; `checkpoint.py` says what is in it.
        progress: Updated while it runs.
        threads: Threads for physics and drawing; 0 for one per CPU. They change no result.
        videos: Film an episode in each evaluation.

    Raises:
        MissingDependency: The extra `rl` is not installed.
        InvalidSetup: The setup makes no sense, or the folder has a run of another training.
        DatasetError: The folder has other things in it, another process trains there, or the disk fails.

    Examples:
        >>> for progress in train(recipe_for("PickCuboid"), "runs/pick"):
        ...     print(progress.steps, progress.score)
    """
    progress = TrainingProgress() if progress is None else progress
    require_trainable(training)
    run = Path(out)
    with lock_run(run):
        yield from _Run(run, agreed(run, training), progress, threads, videos).train()


def require_trainable(training: Training) -> None:
    """Refuse what cannot be trained here, as far as that can be known without building the environment.

    Raises:
        MissingDependency: The extra `rl` is not installed.
        InvalidSetup: The setup names what is not there or does not fit, its task has no reward, or torch cannot use the
            device.
    """
    for name in ("torch", "stable_baselines3"):
        package_of("rl", name)
    if isinstance(resolve(training.setup).task, Free):
        raise InvalidSetup("Free has no reward, so there is nothing to learn; train a task such as PickCuboid.")
    torch = package_of("rl", "torch")
    try:
        torch.zeros(1, device=training.device).item()
    except (RuntimeError, AssertionError) as err:  # the second where torch was built without it
        here = ", ".join(("cpu", *(other for other in ("cuda", "mps") if getattr(torch, other).is_available())))
        raise InvalidSetup(
            f"device is {training.device!r}, on which torch cannot compute here; valid is {here}."
        ) from err
    if isinstance(training.algorithm, Dagger) and training.device != "cpu":
        raise InvalidSetup(f"device is {training.device!r}, and dagger trains on the CPU; leave device out.")


@contextmanager
def lock_run(run: Path) -> Generator[None]:
    """Lock a folder against other processes that train; the lock ends with this process.

    Raises:
        DatasetError: Another process does, the folder has other things in it, or it cannot be written.
    """
    with disk_errors("train", run):
        run.mkdir(parents=True, exist_ok=True)
        if not (run / CHECKPOINTS).exists() and any(path.name != _LOCK for path in run.iterdir()):
            raise DatasetError(f"{run} has other things in it than a training; choose another folder.")
        fd = os.open(run / _LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        if not try_lock(fd, fcntl.LOCK_EX):
            holder = os.read(fd, 32).decode(errors="replace").strip()
            os.close(fd)
            raise DatasetError(f"Another process, {holder}, trains in {run}. Wait for it to end, or stop it.")
        lock = DatasetLock(fd)
        os.ftruncate(fd, 0)
        write_all(fd, f"{os.getpid()}\n".encode())
        (run / CHECKPOINTS).mkdir(exist_ok=True)
        sync_folder(run)
    with lock:
        yield


def agreed(run: Path, training: Training) -> Training:
    """Return a training with the number of threads of the one that began in a run's folder, if it is the same.

    The intervals of evaluations and checkpoints may change. So may the number of steps, unless the step size falls to
    zero by the last one: the steps so far would have been different.

    Raises:
        InvalidSetup: Another training began there, or another version of this program.
        CorruptCheckpoint: All checkpoints are damaged.
    """
    if checkpoints_of(run):
        before = read_training(run)
        if not training.torch_threads:
            training = replace(training, torch_threads=before.torch_threads)
        elif not before.torch_threads:
            before = replace(before, torch_threads=training.torch_threads)
        free = {name: getattr(training, name) for name in _FREE}
        if before.algorithm.schedule == "constant" and before.algorithm == training.algorithm:
            free["steps"] = training.steps
        if different := replace(before, **free).difference(training):
            raise InvalidSetup(
                f"In {run} another training began: {'; '.join(different)}. Give the same options to continue it, or "
                "another folder."
            )
    return training


def cpus() -> int:
    """Return how many CPUs this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def learner_for(training: Training, *, threads: int = 0) -> Learner:
    """Return the learner of a training, in copies of its environment that have begun an episode.

    Args:
        training: The training; where there is a teacher, the copies observe more than the policy.
        threads: Threads for physics and drawing, 0 for one per CPU.

    Raises:
        MissingDependency: The extra `rl` is not installed.
        InvalidSetup: The algorithm does not fit the environment.
    """
    is_taught = isinstance(training.algorithm, Dagger)
    setup = teaching_setup(training.setup) if is_taught else training.setup
    envs = make_vec(setup, copies=training.copies, threads=threads, autoreset="SameStep")
    try:
        return (DaggerLearner if is_taught else Sb3Learner)(training, envs)
    except BaseException:
        envs.close()
        raise


class _Run:
    """One process of a training."""

    def __init__(self, run: Path, training: Training, progress: TrainingProgress, threads: int, videos: bool) -> None:
        self._run, self._progress, self._threads, self._videos = run, progress, threads, videos
        if not training.torch_threads:
            # Networks for states are so small that more threads are slower; convolutions use all of them.
            training = replace(training, torch_threads=cpus() if training.setup.cameras else 1)
        self._training = training
        package_of("rl", "torch").set_num_threads(training.torch_threads)
        self._evaluator: TrainingEvaluator | None = None
        self._learner = learner = learner_for(training, threads=threads)
        self._agent = PolicyAgent(mean_action(learner.policy), learner.flat.layout)
        try:
            self._last = self._restore()
        except BaseException:
            learner.envs.close()
            raise
        self._noted, self._learning, self._made = self._learner.steps, 0.0, 0
        self._started = time.perf_counter() - (self._last.seconds if self._last is not None else 0.0)

    def _restore(self) -> Checkpoint | None:
        """Continue from the newest checkpoint that is not damaged, and return it; None to start from the beginning.

        Raises:
            CorruptCheckpoint: There are checkpoints, and all from which training could continue are damaged.
        """
        damage = ""
        for place in reversed(checkpoints_of(self._run)):
            try:
                checkpoint = open_checkpoint(place)
                if not (place / LEARNER).exists():
                    damage = damage or f"{place} has no {LEARNER}."
                    continue
                saved = checkpoint.policy(), checkpoint.learner(), checkpoint.replay()
            except CorruptCheckpoint as err:
                damage = str(err)
                self._progress.notes.append(f"{err} The one before is tried.")
                continue
            self._learner.load(*saved)
            if checkpoint.steps < self._training.steps:
                self._progress.notes.append(f"Continuing from step {checkpoint.steps}.")
            return checkpoint
        if damage:
            raise CorruptCheckpoint(
                f"No checkpoint of {self._run} is left to continue from: {damage} Train into another folder; the "
                "weights of checkpoints that are whole can still be evaluated."
            )
        return None

    def train(self) -> Iterator[TrainingProgress]:
        """Train; see the function `train`."""
        progress, learner, training = self._progress, self._learner, self._training
        begun = -1 if self._last is None else self._last.steps
        evaluate_every = training.evaluate_every or max(training.steps // 20, 1)
        try:
            remove_old(self._run, keep_after=begun)
            scored = [one for one in whole_checkpoints(self._run) if one.score is not None]
            progress.best, progress.score = best_of(scored), scored[-1].score if scored else None
            with Metrics(self._run, after=begun) as self._metrics:
                if self._last is None:
                    yield from self._evaluate_and_save()
                while not learner.is_done and not progress.is_interrupted:
                    before = learner.steps
                    self._advance()
                    yield progress
                    if learner.is_done or _passes(before, learner.steps, evaluate_every):
                        yield from self._evaluate_and_save()
                    elif _passes(before, learner.steps, training.checkpoint_every or evaluate_every):
                        self._save(None)
                if self._last is not None and self._last.steps < learner.steps:
                    self._save(None)
            self._update("done" if learner.is_done else "interrupted")
            yield progress
        finally:
            for_all([learner.envs.close, *([] if self._evaluator is None else [self._evaluator.close])])

    def _advance(self) -> None:
        """Make an update, and write its figures now and then."""
        learner, start, before = self._learner, time.perf_counter(), self._learner.steps
        learner.advance()
        self._learning += time.perf_counter() - start
        self._made += learner.steps - before
        self._progress.speed = self._made / self._learning
        self._update("learning")
        if _passes(before, learner.steps, max(self._training.steps // _ROWS, 1)):
            self._write_figures()

    def _write_figures(self) -> None:
        """Write the figures of the last update."""
        self._noted = self._learner.steps
        self._metrics.add(self._noted, self._seconds(), {**self._learner.figures(), SPEED: self._progress.speed})
        self._learning, self._made = 0.0, 0  # the speed is that since the last row

    def _update(self, doing: str) -> None:
        progress = self._progress
        progress.doing, progress.steps, progress.seconds = doing, self._learner.steps, self._seconds()

    def _evaluate_and_save(self) -> Iterator[TrainingProgress]:
        """Evaluate the policy and write its checkpoint."""
        progress, training = self._progress, self._training
        self._update("evaluating")
        if not training.episodes:
            self._save(None)
            return
        if self._evaluator is None:
            self._evaluator = TrainingEvaluator(training, self._agent, threads=self._threads)
        attempts: list[Attempt] = []
        for attempt in self._evaluator.attempts():
            attempts.append(attempt)
            yield progress
        score = progress.score = score_of(attempts)
        if self._videos and (reason := self._evaluator.film(self._run / VIDEOS / f"{self._learner.steps:09d}.mp4")):
            progress.notes.append(f"No videos: {reason}")
            self._videos = False
        names = {EPISODES: "episodes", SUCCESSES: "successes", JUDGED: "judged", REWARD: "reward", LENGTH: "length"}
        figures = {name: float(getattr(score, own)) for name, own in names.items()}
        if score.judged:
            figures[RATE] = score.successes / score.judged
        self._metrics.add(self._learner.steps, self._seconds(), figures)
        self._save(score)

    def _save(self, score: Score | None) -> None:
        learner, last = self._learner, self._last
        if self._noted < learner.steps:
            self._write_figures()  # figures since the last row would be missing after a kill
        self._metrics.sync()
        earlier = {} if last is None else last.files
        about = Checkpoint(
            path=self._run,
            training=self._training,
            steps=learner.steps,
            seconds=self._seconds(),
            layout=learner.flat.layout,
            score=score,
            versions={**versions(), **{one: importlib.metadata.version(one) for one in ("torch", "stable-baselines3")}},
            files={name: digest for name, digest in earlier.items() if name.startswith(f"{REPLAY}/")},
        )
        piece = learner.replay_piece(0 if last is None else last.steps // self._training.copies)
        made = self._last = write_checkpoint(
            self._run, about, policy=learner.weights(), learner=learner.state(), piece=piece
        )
        remove_old(self._run)
        self._progress.best = best_of([one for one in (self._progress.best, made) if one is not None])

    def _seconds(self) -> float:
        return time.perf_counter() - self._started


def _passes(before: int, after: int, every: int) -> bool:
    return before // every != after // every
