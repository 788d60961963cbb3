"""Checkpoints on disk: a folder each, which appears whole or not at all, and is read without running anything in it.

A run's folder has

    training.json             what is trained
    checkpoints/<steps>/      complete when it is there
        checkpoint.json       what was trained, what the policy's vectors are, how it did, hashes of the files
        policy.pt             the weights that act
        learner.pt            the rest that training goes on from; of the newest checkpoints alone
    replay/<first>-<last>.pt  transitions that off-policy learners remember, each written once
    metrics.jsonl             a line of figures now and then
    tensorboard/              the same as TensorBoard's events
    videos/<steps>.mp4
    report.html
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rcs_data.durable import disk_errors, remove_tree, sealed, sync_folder, unsealed, write_file
from rcs_data.json_file import read_bytes

from rcs.errors import CorruptCheckpoint, CorruptEpisode, InvalidSetup
from rcs.rl.layout import FlatLayout
from rcs.rl.tensors import from_bytes, to_bytes
from rcs.rl.training import VERSION, Training

CHECKPOINTS = "checkpoints"
DESCRIPTION = "checkpoint.json"
POLICY = "policy.pt"
LEARNER = "learner.pt"
REPLAY = "replay"
RESUMABLE = 3
"""From so many of the newest checkpoints training can go on: if one is damaged, from the one before."""

_PARTIAL = ".partial"
_NAME = re.compile(r"\d{9,}")


@dataclass(frozen=True, kw_only=True)
class Score:
    """How a policy did in the evaluation of its checkpoint."""

    episodes: int
    successes: int
    judged: int
    reward: float
    """Mean sum of an episode's rewards."""
    length: float
    """Mean number of steps of an episode."""

    @property
    def order(self) -> float:
        """A higher one is better: the rate of success, or the reward where nothing is judged.

        Of equal rates, more reward is no better: the dense reward pays for every step, so for being slow, too.
        """
        return self.successes / self.judged if self.judged else self.reward


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """A checkpoint's description; weights are read when they are asked for."""

    path: Path
    """Its folder."""
    training: Training
    """What was trained."""
    steps: int
    """Environment steps that were made before, of all copies together."""
    seconds: float
    """How long training took until here [s]."""
    layout: FlatLayout
    """What the numbers of the policy's vectors are."""
    score: Score | None
    """How the policy did; None where it was not evaluated."""
    versions: Mapping[str, str]
    """Versions of the software that wrote it."""
    files: Mapping[str, str]
    """SHA-256 of the files beside, by name; those of the replay's pieces by their path in the run's folder."""

    def policy(self) -> dict[str, Any]:
        """Return the weights by name, as tensors on the CPU.

        Raises:
            CorruptCheckpoint: The file is not what was written.
        """
        return from_bytes(self._bytes(POLICY), str(self.path / POLICY))

    def learner(self) -> dict[str, Any]:
        """Return the state of the training besides the weights.

        Raises:
            CorruptCheckpoint: The file is not what was written, or was removed since.
        """
        return from_bytes(self._bytes(LEARNER), str(self.path / LEARNER))

    def replay(self) -> list[dict[str, Any]]:
        """Return the pieces of the replay, oldest first.

        Raises:
            CorruptCheckpoint: One is not what was written.
        """
        names = sorted(name for name in self.files if name.startswith(f"{REPLAY}/"))
        return [from_bytes(self._bytes(name), str(self._place(name))) for name in names]

    @property
    def can_be_resumed(self) -> bool:
        """Whether its state of the training is still there."""
        return (self.path / LEARNER).exists()

    def _place(self, name: str) -> Path:
        return (self.path.parent.parent if name.startswith(f"{REPLAY}/") else self.path) / name

    def _bytes(self, name: str) -> bytes:
        path = self._place(name)
        try:
            data = path.read_bytes()
        except OSError as err:
            raise CorruptCheckpoint(f"{path} cannot be read: {err.strerror or err}.") from err
        if hashlib.sha256(data).hexdigest() != self.files.get(name):
            raise CorruptCheckpoint(f"{path} is damaged: its bytes are not what was written.")
        return data


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
        about: Its description; of `files`, the earlier pieces of the replay.
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
            files[name] = _write(run / name, to_bytes(rows))
            sync_folder(run / REPLAY)
        if not folder.is_dir():
            folder.mkdir()
            sync_folder(run)
        remove_tree(partial)
        partial.mkdir()
        files[POLICY] = _write(partial / POLICY, to_bytes(policy))
        files[LEARNER] = _write(partial / LEARNER, to_bytes(learner))
        made = replace(about, path=place, files=files)
        write_file(partial / DESCRIPTION, sealed(_to_json(made)))
        sync_folder(partial)
        remove_tree(place)  # one that was damaged, or is of a run that went on from an earlier one
        partial.rename(place)
        sync_folder(folder)
    return made


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
    if (version := values.get("version")) != VERSION:
        raise InvalidSetup(
            f"{place} was written in version {version!r} of the format of checkpoints; this program reads version "
            f"{VERSION}. Versions that wrote it: {values.get('versions')}."
        )
    try:
        score = values["score"]
        return Checkpoint(
            path=place,
            training=Training.from_json(values["training"], trust=trust),
            steps=int(values["steps"]),
            seconds=float(values["seconds"]),
            layout=FlatLayout.from_json(values["layout"]),
            score=None if score is None else Score(**score),
            versions=dict(values["versions"]),
            files={str(name): str(digest) for name, digest in values["files"].items()},
        )
    except (KeyError, TypeError, ValueError, AttributeError) as err:
        if isinstance(err, InvalidSetup | CorruptCheckpoint):
            raise
        raise CorruptCheckpoint(f"{place / DESCRIPTION} lacks something: {type(err).__name__}: {err}.") from err


def checkpoints_of(run: str | Path) -> list[Path]:
    """Return the folders of a run's checkpoints, oldest first; nothing in them is read."""
    folder = Path(run) / CHECKPOINTS
    if not folder.is_dir():
        return []
    return sorted((path for path in folder.iterdir() if _NAME.fullmatch(path.name)), key=lambda path: int(path.name))


def find_checkpoint(path: str | Path, *, trust: Collection[str] = ()) -> Checkpoint:
    """Return the checkpoint at a path: of a run's folder its best one, or the newest where none was evaluated.

    Args:
        path: Folder of the checkpoint or of the run.
        trust: Modules that may be imported because its setup names a class of theirs.

    Raises:
        InvalidSetup: There is none, or another version of this program wrote it.
        CorruptCheckpoint: It is damaged; of a run's folder, every one is.
    """
    place = Path(path)
    if (place / DESCRIPTION).exists():
        return open_checkpoint(place, trust=trust)
    folders = checkpoints_of(place)
    if not folders:
        raise InvalidSetup(
            f"There is no checkpoint in {place}. Valid is the folder of a run, as `rcs train --out` makes it, or one "
            f"of its folders {CHECKPOINTS}/<steps>."
        )
    found: list[Checkpoint] = []
    damage: list[CorruptCheckpoint] = []
    for folder in folders:
        try:
            found.append(open_checkpoint(folder, trust=trust))
        except CorruptCheckpoint as err:
            damage.append(err)
    if not found:
        raise damage[-1]
    return best_of(found) or found[-1]


def best_of(found: list[Checkpoint]) -> Checkpoint | None:
    """Return the checkpoint that did best, of equal ones the newest; None if none was evaluated."""
    scored = [(one.score.order, one.steps, one) for one in found if one.score is not None]
    return max(scored, key=lambda entry: entry[:2])[2] if scored else None


def remove_old(run: Path, *, keep_after: int | None = None) -> None:
    """Remove what no one needs any more: partial checkpoints, old states of the training, and pieces of the replay.

    Evaluated checkpoints keep their weights; others are removed when they are no longer among the newest.

    Args:
        run: The run's folder.
        keep_after: Also remove all checkpoints after this step: training goes on from there.

    Raises:
        DatasetError: The disk fails.
    """
    folder = run / CHECKPOINTS
    with disk_errors("remove old checkpoints", folder):
        for path in list(folder.iterdir()) if folder.is_dir() else []:
            if path.name.startswith(_PARTIAL):
                remove_tree(path)
        places = checkpoints_of(run)
        if keep_after is not None:
            for place in (place for place in places if int(place.name) > keep_after):
                _drop(place)
            places = [place for place in places if int(place.name) <= keep_after]
        needed: set[str] = set()
        for number, place in enumerate(reversed(places)):
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


def _write(path: Path, data: bytes) -> str:
    write_file(path, data)
    return hashlib.sha256(data).hexdigest()


def _to_json(checkpoint: Checkpoint) -> dict[str, Any]:
    score = checkpoint.score
    return {
        "version": VERSION,
        "training": checkpoint.training.to_json(),
        "steps": checkpoint.steps,
        "seconds": checkpoint.seconds,
        "layout": checkpoint.layout.to_json(),
        "score": None if score is None else vars(score),
        "versions": dict(checkpoint.versions),
        "files": dict(checkpoint.files),
    }
