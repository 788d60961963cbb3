"""Repairs a dataset: what is damaged is put aside, as it was, and everything else can be read again.

First the index and `dataset.json` are restored from each other and from the episodes; then what killed programs left is
completed or removed; then damaged episodes move to `quarantine/`. Nothing guesses at bytes: a damaged episode is
restored from a backup or not at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rcs_data.check.dataset import Depth, check
from rcs_data.check.folder import check_index
from rcs_data.check.report import counted
from rcs_data.errors import CorruptEpisode
from rcs_data.files.durable import disk_errors, quarantine
from rcs_data.files.layout import (
    DATASET_FILE,
    EPISODES_FOLDER,
    FORMER_FOLDER,
    HISTORY_FOLDER,
    INDEX_FILE,
    OPEN_FOLDER,
    has_dataset,
)
from rcs_data.files.lock import DatasetLock
from rcs_data.files.output import OnProgress, remove_leftovers
from rcs_data.index.history import Draft, damaged_history, finish_edit
from rcs_data.index.index import Index, write_info
from rcs_data.record.recover import CUT, settle_leftovers

What = Literal["restored", "recovered", "removed", "quarantined", "failed"]


@dataclass(frozen=True, kw_only=True)
class Mending:
    """One repair."""

    what: What
    """restored: readable again. recovered: completed. removed: garbage. quarantined: damaged, put aside as it was.
    failed: not changed."""
    episode: str | None
    """The episode's id; None for the dataset as a whole."""
    message: str

    def __str__(self) -> str:
        name = "" if self.episode is None else f" episode {self.episode}"
        return f"{self.what}{name}: {self.message}"


def repair(
    path: str | Path,
    *,
    depth: Depth = "frames",
    workers: int | None = None,
    on_progress: OnProgress | None = None,
) -> list[Mending]:
    """Repair what can be repaired, arguments as for `check`; a second call does nothing.

    Returns:
        The repairs, in order; none if nothing was damaged.

    Raises:
        DatasetError: There is no dataset, its layout is of another version, another process writes to it, or the disk
            fails.
    """
    root = Path(path)
    target = root.absolute()
    mendings: list[Mending] = []
    with disk_errors("repair", root):
        mendings += [_done("removed", f"{left.name}, left by a killed program") for left in remove_leftovers(target)]
    if mendings and not has_dataset(root) and not (root / DATASET_FILE).exists():
        return mendings
    check_index(root)  # before a lock is created
    with DatasetLock.writer(root), disk_errors("repair", root):
        try:
            finish_edit(root)
            mendings += _mend_index(root)
            index = Index(root)
        except CorruptEpisode as err:
            return [*mendings, _done("failed", str(err))]
        mendings += _settle(index)
        findings = check(root, depth=depth, workers=workers, on_progress=on_progress).findings
        damaged = {f.episode for f in findings if f.severity == "damage" and f.kind not in ("former", "other_layout")}
        mendings += _put_aside(index, sorted(name for name in damaged if name is not None and name in index.entries))
        for folder in sorted({root / Path(f.file).parent for f in findings if f.kind == "former"}):
            quarantine(root, folder)
            mendings.append(_done("quarantined", f"{folder.name}, a damaged former episode; undo cannot bring it back"))
    return mendings


def _mend_index(root: Path) -> list[Mending]:
    """Restore `dataset.json` and its copy from each other, and the index from its whole lines."""
    mendings: list[Mending] = []
    contents, findings = check_index(root)
    if contents is None:
        return []
    files = {finding.file for finding in findings if finding.kind != "history"}
    if files - {INDEX_FILE}:
        write_info(root, contents.info)
        mendings.append(_done("restored", f"{DATASET_FILE}, of which there are two"))
    if INDEX_FILE in files:
        Index.create(root, contents.info, contents.entries)
        lines = counted(len(contents.entries), "whole line")
        message = f"the index, with {lines}; other episodes are taken from their folders"
        mendings.append(_done("restored", message))
    for path, _ in list(damaged_history(root)):
        quarantine(root, path)
        mendings.append(_done("quarantined", f"{HISTORY_FOLDER}/{path.name}; undo cannot go back to it"))
    return mendings


def _settle(index: Index) -> list[Mending]:
    """Complete and remove what killed programs left."""
    report = settle_leftovers(index, "recover")
    completed = (*report.recovered, *report.published)
    mendings = [
        Mending(what="recovered", episode=name, message=f"completed, and in the index{CUT * (name in report.cut)}")
        for name in completed
    ]
    mendings += [Mending(what="removed", episode=name, message="had no rows") for name in report.removed]
    for name, why in report.failed:
        folder = index.root / OPEN_FOLDER / name
        if folder.exists():  # it would be in the way of every edit
            quarantine(index.root, folder, f"open-{name}")
        else:
            quarantine(index.root, index.root / EPISODES_FOLDER / name)
        mendings.append(Mending(what="quarantined", episode=name, message=why))
    return mendings


def _put_aside(index: Index, damaged: list[str]) -> list[Mending]:
    """Take damaged episodes out of the index, and move their folders to the quarantine."""
    if not damaged:
        return []
    root = index.root
    folders = {name: index.entries[name].folder for name in damaged}
    kept = {name: entry for name, entry in index.entries.items() if name not in folders}
    Draft(index).decide("repair", {"episodes": damaged}, kept, index.info)
    mendings: list[Mending] = []
    for name, folder in folders.items():
        where = "its folder is gone"
        if (root / FORMER_FOLDER / folder).exists():
            where = f"damaged; its files are in {quarantine(root, root / FORMER_FOLDER / folder).relative_to(root)}"
        mendings.append(Mending(what="quarantined", episode=name, message=where))
    return mendings


def _done(what: What, message: str) -> Mending:
    return Mending(what=what, episode=None, message=message)
