"""Repairs what can be repaired in a dataset. Damaged files are kept in `quarantine/`, and undo is possible.

First the rest of the folder: `dataset.json` and its copy are restored from each other, and leftovers of a killed writer
or edit are recovered. Then the episodes, all in one edit: damaged ones are put into quarantine.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from rcs_data.check.dataset import check
from rcs_data.check.descriptions import check_head
from rcs_data.check.episode_rows import EpisodeRows
from rcs_data.check.generations import DAMAGED, REPAIR, damaged_former
from rcs_data.check.images import right_flags
from rcs_data.check.report import Finding, counted
from rcs_data.durable import disk_errors, link_file, sync_folder, write_file
from rcs_data.edit.rows import rows_of
from rcs_data.edit.transaction import Transaction, editing
from rcs_data.errors import CorruptEpisode
from rcs_data.flags import companion
from rcs_data.head import read_head, write_head
from rcs_data.info import DatasetInfo
from rcs_data.layout import (
    COPY_FILE,
    DATASET_FILE,
    QUARANTINE_FOLDER,
    episode_folder,
    episodes_folder,
    generation_folder,
    open_folder,
)
from rcs_data.lock import DatasetLock
from rcs_data.output import OnProgress
from rcs_data.reader import EpisodeRecord
from rcs_data.recover import recover

What = Literal["restored", "recovered", "removed", "rewritten", "recomputed", "quarantined", "noted", "failed"]
_REWRITTEN = ("timing", "flags", "wrong_id")


@dataclass(frozen=True, kw_only=True)
class Mending:
    """One repair."""

    what: What
    """restored: bit for bit. rewritten: with the readable part. quarantined: nothing is readable. noted: listed in the
    history, not changed. failed: not changed."""
    episode: str | None
    """The episode's id; None for the dataset as a whole."""
    message: str
    """What was done, in words."""

    def __str__(self) -> str:
        """Return it on one line."""
        name = "" if self.episode is None else f" episode {self.episode}"
        return f"{self.what}{name}: {self.message}"


@dataclass(frozen=True, kw_only=True)
class RepairReport:
    """The result of `repair`."""

    mendings: tuple[Mending, ...]
    """The repairs, in order; none if nothing was damaged."""

    def __str__(self) -> str:
        """Return one line per repair."""
        return "\n".join(map(str, self.mendings)) or "nothing to repair"

    def to_json(self) -> list[dict[str, Any]]:
        """Return it as JSON values."""
        return [asdict(mending) for mending in self.mendings]


def repair(
    path: str | Path,
    *,
    decode_frames: bool = True,
    workers: int | None = None,
    on_progress: OnProgress | None = None,
) -> RepairReport:
    """Repair what can be repaired; a second call does nothing.

    Args:
        path: The dataset's folder.
        decode_frames: Whether each image is decoded to find damage.
        workers: Threads of the check; None for one per core.
        on_progress: Called with the number of episodes checked and in all.

    Raises:
        DatasetError: There is no dataset, its layout is newer than this code, another process writes to it, or the disk
            fails.
    """
    root = Path(path)
    mendings = _mend_head(root)
    try:
        read_head(root)
    except CorruptEpisode as err:
        return RepairReport(mendings=(*mendings, Mending(what="failed", episode=None, message=str(err))))
    mendings += _settle(root)
    findings = check(root, decode_frames=decode_frames, workers=workers, on_progress=on_progress).findings
    newer = {f.episode for f in findings if f.kind == "newer_layout"}
    damaged = {f.episode for f in findings if f.episode and f.severity == "damage" and f.kind != "former"} - newer
    rewritten = {f.episode for f in findings if f.episode and f.kind in _REWRITTEN} - damaged - newer
    if damaged or rewritten or any(f.kind == "former" for f in findings):
        mendings += _mend_episodes(root, sorted(filter(None, damaged)), sorted(filter(None, rewritten)), findings)
    return RepairReport(mendings=tuple(mendings))


def _mend_head(root: Path) -> list[Mending]:
    """Restore `dataset.json` and its copy from whichever is whole."""
    check_head(root)  # before a lock is created
    lock = DatasetLock.writer(root)
    try:
        head, findings = check_head(root)
        how = f"from what {COPY_FILE if any(f.file == DATASET_FILE for f in findings) else DATASET_FILE} says"
        if head is None or not findings:
            return []
        with disk_errors("restore the dataset's description", root):
            for finding in findings:
                if finding.kind == "altered":
                    _quarantine_file(root, root / finding.file)
            write_head(root, head)
        message = f"{' and '.join(sorted({f.file for f in findings}, reverse=True))}, {how}"
        return [Mending(what="restored", episode=None, message=message)]
    finally:
        lock.release()


def _settle(root: Path) -> list[Mending]:
    """Recover the dataset; what cannot be recovered goes to quarantine, since it would block every edit."""
    report = recover(root)
    mendings = [Mending(what="recovered", episode=name, message="its writer was gone") for name in report.recovered]
    mendings += [Mending(what="recovered", episode=name, message="it was finished") for name in report.published]
    mendings += [Mending(what="removed", episode=name, message="open, without a row") for name in report.removed]
    if not report.failed:
        return mendings
    lock = DatasetLock.writer(root)
    try:
        base = generation_folder(root, read_head(root).generation)
        with disk_errors("put what cannot be recovered into quarantine", root):
            for name, reason in report.failed:
                target = _new_quarantine(root, f"open-{name}")
                open_folder(base, name).rename(target)
                sync_folder(episodes_folder(base))
                message = f"{reason} It is in {target.relative_to(root)}."
                mendings.append(Mending(what="quarantined", episode=name, message=message))
    finally:
        lock.release()
    return mendings


def _mend_episodes(
    root: Path, damaged: list[str], rewritten: list[str], findings: tuple[Finding, ...]
) -> list[Mending]:
    """Make a generation with the damaged episodes repaired and all others unchanged."""
    head = read_head(root)
    base = generation_folder(root, head.generation)
    listed = [str(episode_folder(base, name).relative_to(root)) for name in damaged]
    arguments = {
        "damaged_episodes": damaged,
        "rewritten": rewritten,
        DAMAGED: sorted({*damaged_former(root, head), *listed}),
    }
    mendings: list[Mending] = []
    made: list[Path] = []
    try:
        with editing(root, REPAIR, arguments) as edit:
            for episode in edit.dataset.episodes:
                if episode.id in rewritten:
                    mendings.append(_rewrite(edit, episode))
                elif episode.id not in damaged:
                    edit.keep(episode)
            for name in damaged:
                found = [finding for finding in findings if finding.episode == name]
                place = _quarantine(root, episode_folder(base, name), found)
                made.append(place)
                message = f"its files are in {place.relative_to(root)}."
                mendings.append(Mending(what="quarantined", episode=name, message=message))
    except BaseException:
        for place in made:  # links to files that stay in place
            shutil.rmtree(place, ignore_errors=True)
        raise
    former = len(arguments[DAMAGED]) - len(listed)
    if former:
        message = f"{counted(former, 'damaged folder')} of former generations: an undo can bring the damage back"
        mendings.append(Mending(what="noted", episode=None, message=message))
    return mendings


def _rewrite(edit: Transaction, episode: EpisodeRecord) -> Mending:
    """Write an episode with flags and timing report recomputed from its rows."""
    rows = rows_of(episode)
    edit.write(episode, _with_right_flags(rows, episode.info))
    return Mending(what="recomputed", episode=episode.id, message="flags and timing report, from its rows")


def _with_right_flags(table: pa.Table, info: DatasetInfo) -> pa.Table:
    rows = EpisodeRows(info)
    rows.add(table)
    for key, log in rows.frames.items():
        log.is_new = table.column(key).is_valid().to_pylist()
    for keys in rows.cameras.values():
        name = companion(keys[0], info.features, "flags")
        if name is not None:
            place = table.schema.get_field_index(name)
            column = pa.array(np.asarray(right_flags(rows, keys)))
            table = table.set_column(place, table.schema.field(place), column)
    return table


def _quarantine(root: Path, folder: Path, findings: Iterable[Finding]) -> Path:
    """Link a damaged episode's files, with the findings, to where no edit or prune removes them."""
    target = _new_quarantine(root, folder.name)
    target.mkdir()
    for file in sorted(folder.iterdir()):
        if file.is_file():
            link_file(file, target / file.name)
    found = [finding.to_json() for finding in findings]
    write_file(target / "findings.json", json.dumps(found, indent=1, ensure_ascii=False).encode())
    sync_folder(target)
    sync_folder(target.parent)
    return target


def _quarantine_file(root: Path, path: Path) -> None:
    target = _new_quarantine(root, path.name)
    link_file(path, target)
    sync_folder(target.parent)


def _new_quarantine(root: Path, name: str) -> Path:
    (root / QUARANTINE_FOLDER).mkdir(exist_ok=True)
    number = 1
    while (target := root / QUARANTINE_FOLDER / f"{name}-{number}").exists():
        number += 1
    return target
