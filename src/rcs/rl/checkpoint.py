"""Checkpoints on disk: a folder each, which appears whole or not at all, and is read without running code from it.

A run's folder has

    checkpoints/<steps>/      complete when it is there
        checkpoint.json       the training, the layout of the policy's vectors, its score, hashes of the files
        policy.pt             the weights that act
        learner.pt            the rest from which training continues; in the newest checkpoints alone
    replay/<first>-<last>.pt  transitions that learners remember, each written once
    metrics.jsonl             a line of figures now and then
    videos/<steps>.mp4
    report.html
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rcs_data.files.durable import disk_errors, remove_tree, sealed, sync_folder, unsealed, write_file
from rcs_data.files.json_file import read_bytes
from rcs_data.options import Natural, Record

from rcs.errors import CorruptCheckpoint, CorruptEpisode, InvalidSetup
from rcs.extras import package_of
from rcs.rl.layout import FlatLayout
from rcs.rl.training import VERSION, Training

CHECKPOINTS = "checkpoints"
DESCRIPTION = "checkpoint.json"
POLICY = "policy.pt"
LEARNER = "learner.pt"
REPLAY = "replay"
VIDEOS = "videos"
RESUMABLE = 3
"""Training can continue from so many of the newest checkpoints: if one is damaged, from the one before."""

_PARTIAL = ".partial"
_NAME = re.compile(r"\d{9,}")
_ARRAY = "__array__"
"""Key of an array among the values of a file, to distinguish it from a tensor."""


class Score(Record):
    """Result of a policy in the evaluation of its checkpoint."""

    episodes: Natural
    """Episodes."""
    successes: Natural
    """Episodes that were judged and succeeded."""
    judged: Natural
    """Episodes that the task judged."""
    reward: float
    """Mean sum of an episode's rewards."""
    length: float
    """Mean number of steps of an episode."""

    @property
    def order(self) -> float:
        """A higher one is better: the rate of success, or the reward where nothing is judged.

        Among equal rates, more reward is no better: the dense reward pays for every step, so for being slow, too.
        """
        return self.successes / self.judged if self.judged else self.reward


class Checkpoint(Record):
    """A checkpoint's description; weights are read on demand."""

    path: Path
    """Its folder."""
    training: Training
    """The training."""
    steps: Natural
    """Environment steps that were made before, of all copies together."""
    seconds: float
    """Duration of the training until here [s]."""
    layout: FlatLayout
    """The numbers of the policy's vectors."""
    score: Score | None
    """Result of the policy; None where it was not evaluated."""
    versions: Mapping[str, str]
    """Versions of the software that wrote it."""
    files: Mapping[str, str]
    """SHA-256 of the files beside, by name, and of the replay's pieces, by their path in the run's folder."""

    def policy(self) -> dict[str, Any]:
        """Return the weights by name, as tensors on the CPU.

        Raises:
            CorruptCheckpoint: The file is not what was written.
        """
        return self._read(POLICY)

    def learner(self) -> dict[str, Any]:
        """Return the state of the training besides the weights.

        Raises:
            CorruptCheckpoint: The file is not what was written, or was removed since.
        """
        return self._read(LEARNER)

    def replay(self) -> list[dict[str, Any]]:
        """Return the pieces of the replay, oldest first.

        Raises:
            CorruptCheckpoint: One is not what was written.
        """
        return [self._read(name) for name in sorted(self.files) if name.startswith(f"{REPLAY}/")]

    def _read(self, name: str) -> dict[str, Any]:
        path = (self.path.parent.parent if name.startswith(f"{REPLAY}/") else self.path) / name
        try:
            data = path.read_bytes()
        except OSError as err:
            raise CorruptCheckpoint(f"{path} cannot be read: {err.strerror or err}.") from err
        if hashlib.sha256(data).hexdigest() != self.files.get(name):
            raise CorruptCheckpoint(f"{path} is damaged: its bytes are not what was written.")
        return unpacked(data, path)


def packed(values: Mapping[str, Any]) -> bytes:
    """Return nested dictionaries, lists and tuples of tensors, arrays, numbers and texts as a file of torch."""
    file = io.BytesIO()
    package_of("rl", "torch").save(_with_tensors(values), file)
    return file.getvalue()


def unpacked(data: bytes, path: Path) -> dict[str, Any]:
    """Return the values that `packed` wrote, tensors on the CPU; nothing in the bytes is run.

    Args:
        data: The bytes.
        path: The file, for the message.

    Raises:
        CorruptCheckpoint: They are not such values.
    """
    try:
        return _with_arrays(package_of("rl", "torch").load(io.BytesIO(data), map_location="cpu", weights_only=True))
    except Exception as err:  # torch raises whatever the damage leads to
        raise CorruptCheckpoint(f"{path} is damaged: {type(err).__name__}: {str(err).splitlines()[0]}") from err


def _with_tensors(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _with_tensors(own) for key, own in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(map(_with_tensors, value))
    if isinstance(value, np.ndarray):
        return {_ARRAY: package_of("rl", "torch").from_numpy(np.array(value, order="C"))}
    return value.item() if isinstance(value, np.generic) else value


def _with_arrays(value: Any) -> Any:
    if isinstance(value, dict):
        return value[_ARRAY].numpy() if _ARRAY in value else {key: _with_arrays(own) for key, own in value.items()}
    return type(value)(map(_with_arrays, value)) if isinstance(value, list | tuple) else value


def write_checkpoint(
    run: Path,
    about: Checkpoint,
    *,
    policy: Mapping[str, Any],
    learner: Mapping[str, Any],
    piece: tuple[int, int, Mapping[str, Any]] | None = None,
) -> Checkpoint:
    """Write a checkpoint into a run's folder, in one step, and return it.

    Args:
        run: The run's folder.
        about: Its description; `files` has the earlier pieces of the replay.
        policy: The weights.
        learner: The rest of the training's state.
        piece: First row, row after the last, and rows of what the replay took in since the last checkpoint.

    Raises:
        DatasetError: The disk fails.
    """
    folder = run / CHECKPOINTS
    place = folder / f"{about.steps:09d}"
    partial = folder / f"{_PARTIAL}-{place.name}"
    files = dict(about.files)
    with disk_errors("write a checkpoint", place):
        if piece is not None:
            first, last, rows = piece
            name = f"{REPLAY}/{first:012d}-{last:012d}.pt"
            (run / REPLAY).mkdir(exist_ok=True)
            files[name] = _write(run / name, rows)
            sync_folder(run / REPLAY)
        remove_tree(partial)
        partial.mkdir()
        files[POLICY] = _write(partial / POLICY, policy)
        files[LEARNER] = _write(partial / LEARNER, learner)
        made = replace(about, path=place, files=files)
        values = {name: own for name, own in made.to_json().items() if name != "path"}
        write_file(partial / DESCRIPTION, sealed({"version": VERSION, **values}))
        sync_folder(partial)
        remove_tree(place)  # a damaged one, or one of a run that continued from an earlier one
        partial.rename(place)
        sync_folder(folder)
    return made


def _write(path: Path, values: Mapping[str, Any]) -> str:
    data = packed(values)
    write_file(path, data)
    return hashlib.sha256(data).hexdigest()


def open_checkpoint(path: str | Path, *, trust: Collection[str] = ()) -> Checkpoint:
    """Read the description of a checkpoint.

    Args:
        path: Its folder.
        trust: Modules that may be imported because its setup names a class of theirs.

    Raises:
        CorruptCheckpoint: It is incomplete or damaged.
        InvalidSetup: Another version of this program wrote it, or its setup makes no sense here.
    """
    place = Path(path)
    try:
        values = unsealed(read_bytes(place / DESCRIPTION), place / DESCRIPTION)
    except CorruptEpisode as err:
        raise CorruptCheckpoint(str(err)) from err
    if (version := values.pop("version", None)) != VERSION:
        raise InvalidSetup(
            f"{place} was written in version {version!r} of the format of checkpoints; this program reads version "
            f"{VERSION}. Versions that wrote it: {values.get('versions')}."
        )
    try:
        training = Training.from_json(values.get("training", {}), trust=trust)
        return Checkpoint.from_json({**values, "path": place, "training": training})
    except InvalidSetup as err:
        raise InvalidSetup(f"{place / DESCRIPTION}: {err}") from err


def checkpoints_of(run: str | Path) -> list[Path]:
    """Return the folders of a run's checkpoints, oldest first; nothing in them is read."""
    folder = Path(run) / CHECKPOINTS
    found = folder.iterdir() if folder.is_dir() else ()
    return sorted((path for path in found if _NAME.fullmatch(path.name)), key=lambda path: int(path.name))


def whole_checkpoints(run: str | Path, *, trust: Collection[str] = ()) -> list[Checkpoint]:
    """Return the checkpoints of a run that are not damaged, oldest first.

    Raises:
        CorruptCheckpoint: There are checkpoints, and all are damaged.
        InvalidSetup: Another version of this program wrote one.
    """
    found: list[Checkpoint] = []
    damage: CorruptCheckpoint | None = None
    for folder in checkpoints_of(run):
        try:
            found.append(open_checkpoint(folder, trust=trust))
        except CorruptCheckpoint as err:
            damage = err
    if damage is not None and not found:
        raise damage
    return found


def find_checkpoint(path: str | Path, *, trust: Collection[str] = ()) -> Checkpoint:
    """Return the checkpoint at a path: for a run's folder its best one, or the newest where none was evaluated.

    Args:
        path: Folder of the checkpoint or of the run.
        trust: Modules that may be imported because its setup names a class of theirs.

    Raises:
        InvalidSetup: There is none, or another version of this program wrote it.
        CorruptCheckpoint: It is damaged, or every one in the run's folder is.
    """
    place = Path(path)
    if (place / DESCRIPTION).exists():
        return open_checkpoint(place, trust=trust)
    found = whole_checkpoints(place, trust=trust)
    if not found:
        raise InvalidSetup(
            f"There is no checkpoint in {place}. Valid is the folder of a run, as `rcs train --out` makes it, or one "
            f"of its folders {CHECKPOINTS}/<steps>."
        )
    return best_of(found) or found[-1]


def read_training(run: Path, *, trust: Collection[str] = ()) -> Training:
    """Return the training of a run's folder, as its newest checkpoint has it.

    Args:
        run: The folder.
        trust: Modules that may be imported because the setup names a class of theirs.

    Raises:
        InvalidSetup: There is no run, or another version of this program began it.
        CorruptCheckpoint: All checkpoints are damaged.
    """
    if not (checkpoints := whole_checkpoints(run, trust=trust)):
        raise InvalidSetup(f"There is no training in {run}; `rcs train TASK --out {run}` begins one.")
    return checkpoints[-1].training


def best_of(found: Sequence[Checkpoint]) -> Checkpoint | None:
    """Return the checkpoint with the best score, of equal ones the newest; None if none was evaluated."""
    scored = [(one.score.order, one.steps, one) for one in found if one.score is not None]
    return max(scored, key=lambda entry: entry[:2])[2] if scored else None


def remove_old(run: Path, *, keep_after: int | None = None) -> None:
    """Remove files that are needed no more: partial checkpoints, old states of the training, and pieces of the replay.

    Evaluated checkpoints keep their weights; others are removed when they are no longer among the newest.

    Args:
        run: The run's folder.
        keep_after: Also remove all checkpoints after this step: training continues from there.

    Raises:
        DatasetError: The disk fails.
    """
    folder = run / CHECKPOINTS
    with disk_errors("remove old checkpoints", folder):
        for path in list(folder.glob(f"{_PARTIAL}*")):
            remove_tree(path)
        for place in checkpoints_of(run):
            if keep_after is not None and int(place.name) > keep_after:
                _drop(place)
        needed: set[str] = set()
        for number, place in enumerate(reversed(checkpoints_of(run))):
            try:
                checkpoint = open_checkpoint(place)
            except (CorruptCheckpoint, InvalidSetup):
                continue  # it stays, to be looked at
            if number < RESUMABLE:
                needed.update(checkpoint.files)
            elif checkpoint.score is None:
                _drop(place)
            else:
                (place / LEARNER).unlink(missing_ok=True)
        for piece in (run / REPLAY).glob("*.pt"):
            if f"{REPLAY}/{piece.name}" not in needed:
                piece.unlink()


def _drop(place: Path) -> None:
    """Remove a checkpoint: first its name, so that half of it is never taken for one."""
    trash = place.with_name(f"{_PARTIAL}-trash")
    remove_tree(trash)
    place.rename(trash)
    remove_tree(trash)
