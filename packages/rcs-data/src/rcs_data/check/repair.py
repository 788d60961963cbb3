"""Repairs a dataset: what is damaged is put aside, as it was, and everything else can be read again.

First the index and `dataset.json` are restored from each other and from the episodes; then what killed programs left is
completed or removed; then damaged episodes move to `quarantine/`. Nothing guesses at bytes: a damaged episode is
restored from a backup or not at all.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from rcs_data.about import read_about
from rcs_data.check.dataset import Depth, check
from rcs_data.check.folder import WholeLines, check_index, described, whole_lines
from rcs_data.check.report import counted
from rcs_data.durable import disk_errors, sync_folder
from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.index import Changes, Entry, State
from rcs_data.journal import Journal, write_state
from rcs_data.layout import (
    JOURNAL_FILE,
    QUARANTINE_FOLDER,
    edit_number,
    episode_folder,
    episodes_folder,
    has_dataset,
    open_folder,
)
from rcs_data.lock import DatasetLock
from rcs_data.output import OnProgress, remove_leftovers
from rcs_data.recover import settle_leftovers, stray_folders, write_description

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


@dataclass(frozen=True, kw_only=True)
class RepairReport:
    """The result of `repair`."""

    mendings: tuple[Mending, ...]
    """The repairs, in order; none if nothing was damaged."""

    def __str__(self) -> str:
        return "\n".join(map(str, self.mendings)) or "nothing to repair"

    def to_json(self) -> list[dict[str, Any]]:
        """Return it as JSON values."""
        return [asdict(mending) for mending in self.mendings]


def repair(
    path: str | Path,
    *,
    depth: Depth = "frames",
    workers: int | None = None,
    on_progress: OnProgress | None = None,
) -> RepairReport:
    """Repair what can be repaired, arguments as for `check`; a second call does nothing.

    Raises:
        DatasetError: There is no dataset, its layout is of another version, another process writes to it, or the disk
            fails.
    """
    root = Path(path)
    target = root.absolute()
    mendings: list[Mending] = []
    with disk_errors("repair", root):
        mendings += [_done("removed", f"{left.name}, left by a killed program") for left in remove_leftovers(target)]
    if mendings and not has_dataset(root) and described(root) is None:
        return RepairReport(mendings=tuple(mendings))
    check_index(root)  # before a lock is created
    with DatasetLock.writer(root), disk_errors("repair", root):
        mendings += _mend_index(root)
        try:
            journal = Journal(root)
        except CorruptEpisode as err:
            return RepairReport(mendings=(*mendings, _done("failed", str(err))))
        mendings += _settle(journal)
        findings = check(root, depth=depth, workers=workers, on_progress=on_progress).findings
        damaged = {f.episode for f in findings if f.severity == "damage" and f.kind not in ("former", "other_layout")}
        mendings += _put_aside(
            journal, sorted(name for name in damaged if name is not None and name in journal.state.episodes)
        )
        for folder in sorted({root / Path(f.file).parent for f in findings if f.kind == "former"}):
            _move(root, folder)
            mendings.append(_done("quarantined", f"{folder.name}, a damaged former episode; undo cannot bring it back"))
    return RepairReport(mendings=tuple(mendings))


def _mend_index(root: Path) -> list[Mending]:
    """Restore the index and `dataset.json` from what is whole."""
    mendings: list[Mending] = []
    findings = check_index(root)[1]
    if any(finding.file == JOURNAL_FILE for finding in findings):
        lines = whole_lines(root)
        if lines.state is None:
            return []
        mendings += _take_lost_edits(root, lines, lines.state)
        count = lines.damaged
        if not episodes_folder(root).is_dir():
            episodes_folder(root).mkdir()
        write_state(root, lines.state)
        what = f"the index without {counted(count, 'damaged line')}" if count else "the index, from dataset.json"
        mendings.append(
            _done("restored", f"{what}; episodes that it does not have any more are taken from their folders")
        )
    elif findings:
        mendings.append(_done("restored", "dataset.json, from the index"))
    if findings:
        write_description(root, Journal(root).state.info)
    return mendings


def _take_lost_edits(root: Path, lines: WholeLines, state: State) -> list[Mending]:
    """Add to what the index says what its lost lines did: the newest folders that edits wrote, and what is shared.

    Folders of edits that stay unlisted are put aside; nothing tells whether they are garbage.
    """
    told = described(root)
    state.info = state.info if told is None else told.info
    deleted = {name for one in state.former for name in one.entries} - set(state.episodes)
    mendings: list[Mending] = []
    for folder in sorted(stray_folders(root, state)[0], key=lambda folder: edit_number(folder.name)):
        try:
            entry = Entry.of(read_about(folder), folder.name, state.info)
        except (CorruptEpisode, DatasetError):
            entry = None
        present = None if entry is None else state.episodes.get(entry.id)
        is_newer = edit_number(folder.name) > (-1 if present is None else edit_number(present.folder))
        if entry is not None and is_newer and entry.id not in deleted and folder.name not in lines.folders:
            state.episodes[entry.id] = entry
            mendings.append(Mending(what="restored", episode=entry.id, message=f"from {folder.name}"))
    kept = {entry.folder for entry in state.episodes.values()}
    former = [episode_folder(root, entry.folder) for entry in state.former_entries() if entry.folder not in kept]
    for folder in filter(Path.is_dir, former):
        _move(root, folder)
        mendings.append(_done("quarantined", f"{folder.name}, a former episode; undo cannot bring it back"))
    for folder in stray_folders(root, state)[0]:
        if folder.name not in kept:
            _move(root, folder)
            mendings.append(_done("quarantined", f"{folder.name}, of an edit whose line in the index is lost"))
    return mendings


def _settle(journal: Journal) -> list[Mending]:
    """Complete and remove what killed programs left."""
    garbage, unlisted = stray_folders(journal.root, journal.state)
    mendings = [_done("removed", f"{folder.name}, left by a killed program") for folder in garbage]
    unreadable = set(unlisted)
    report = settle_leftovers(journal, "recover")
    completed = (*report.recovered, *report.published)
    mendings += [Mending(what="recovered", episode=name, message="completed, and in the index") for name in completed]
    mendings += [Mending(what="removed", episode=name, message="had no rows") for name in report.removed]
    for name, why in report.failed:
        folder = episode_folder(journal.root, name)
        if folder in unreadable:
            _move(journal.root, folder)
        else:  # it would be in the way of every edit
            _move(journal.root, open_folder(journal.root, name), f"open-{name}")
        mendings.append(Mending(what="quarantined", episode=name, message=why))
    return mendings


def _put_aside(journal: Journal, damaged: list[str]) -> list[Mending]:
    """Take damaged episodes out of the index, and move their folders to the quarantine."""
    if not damaged:
        return []
    folders = {name: episode_folder(journal.root, journal.state.episodes[name].folder) for name in damaged}
    journal.edit("repair", {"episodes": damaged}, Changes(dropped=tuple(damaged)))
    mendings: list[Mending] = []
    for name, folder in folders.items():
        where = "its folder is gone"
        if folder.exists():
            where = f"damaged; its files are in {_move(journal.root, folder).relative_to(journal.root)}"
        mendings.append(Mending(what="quarantined", episode=name, message=where))
    return mendings


def _move(root: Path, folder: Path, name: str = "") -> Path:
    """Move a folder to a free name in the quarantine, like its own or another one, and return that."""
    quarantine = root / QUARANTINE_FOLDER
    quarantine.mkdir(exist_ok=True)
    target = quarantine / (name or folder.name)
    number = 1
    while target.exists():
        number += 1
        target = quarantine / f"{name or folder.name}-{number}"
    try:
        folder.rename(target)
    except OSError as err:
        raise DatasetError(f"Cannot move {folder} to {target}: {err.strerror or err}.") from err
    sync_folder(quarantine)
    sync_folder(folder.parent)
    return target


def _done(what: What, message: str) -> Mending:
    return Mending(what=what, episode=None, message=message)
