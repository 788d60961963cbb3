"""The folder of a run: its lock and the record of its training."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Collection, Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from rcs_data.durable import disk_errors, sealed, sync_folder, unsealed, write_all, write_file
from rcs_data.json_file import read_bytes
from rcs_data.lock import DatasetLock, try_lock

from rcs.errors import CorruptCheckpoint, CorruptEpisode, DatasetError, InvalidSetup
from rcs.rl.checkpoint import checkpoints_of, open_checkpoint
from rcs.rl.training import VERSION, Training

RECORD = "training.json"
VIDEOS = "videos"
_LOCK = ".training.lock"
# These change neither the weights nor how they come about.
_FREE = ("evaluate_every", "episodes", "checkpoint_every")


@contextmanager
def lock_run(run: Path) -> Generator[None]:
    """Lock a folder against other processes that train; the lock ends with this process.

    Raises:
        DatasetError: Another process does, the folder has other things in it, or it cannot be written.
    """
    with disk_errors("train", run):
        run.mkdir(parents=True, exist_ok=True)
        if not (run / RECORD).exists() and any(path.name != _LOCK for path in run.iterdir()):
            raise DatasetError(f"{run} has other things in it than a training; choose another folder.")
        fd = os.open(run / _LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        if not try_lock(fd, fcntl.LOCK_EX):
            holder = os.read(fd, 32).decode(errors="replace").strip()
            os.close(fd)
            raise DatasetError(f"Another process, {holder}, trains in {run}. Wait for it to end, or stop it.")
        lock = DatasetLock(fd)
        os.ftruncate(fd, 0)
        write_all(fd, f"{os.getpid()}\n".encode())
    try:
        yield
    finally:
        lock.release()


def agreed(run: Path, training: Training) -> Training:
    """Return a training with the number of threads of the one that began in a run's folder, if it is the same.

    The intervals of evaluations and checkpoints may change. So may the number of steps, unless the step size falls to
    zero by the last one: the steps so far would have been different.

    Raises:
        InvalidSetup: Another training began there, or another version of this program.
    """
    if (run / RECORD).exists() or checkpoints_of(run):
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


def write_training(run: Path, training: Training) -> None:
    """Write the record of a training into a run's folder.

    Raises:
        DatasetError: It cannot be written.
    """
    with disk_errors("write what is trained", run / RECORD):
        write_file(run / RECORD, sealed({"version": VERSION, "training": training.to_json()}))
        sync_folder(run)


def read_training(run: Path, *, trust: Collection[str] = ()) -> Training:
    """Return the training of a run's folder.

    Args:
        run: The folder.
        trust: Modules that may be imported because the setup names a class of theirs.

    Raises:
        InvalidSetup: There is no run, or another version of this program began it.
        CorruptCheckpoint: The record and all checkpoints are damaged.
    """
    path = run / RECORD
    if not path.exists() and not checkpoints_of(run):
        raise InvalidSetup(f"There is no training in {run}; `rcs train TASK --out {run}` begins one.")
    try:
        values = unsealed(read_bytes(path), path)
        version, training = values.get("version"), values["training"]
    except (CorruptEpisode, KeyError) as err:
        for place in reversed(checkpoints_of(run)):
            try:
                return open_checkpoint(place, trust=trust).training
            except CorruptCheckpoint:
                continue
        raise CorruptCheckpoint(f"{path} is damaged, and there is no checkpoint: {err}") from err
    if version != VERSION:
        raise InvalidSetup(f"{path} is of version {version!r}; this program reads version {VERSION}.")
    return Training.from_json(training, trust=trust)
