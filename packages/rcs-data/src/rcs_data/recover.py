"""Completes a dataset after its writer died: open episodes become whole ones, garbage is removed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rcs_data.about import read_about
from rcs_data.compact import compact, publish
from rcs_data.durable import disk_errors, remove_folder, remove_tree, sealed, sync_folder, unsealed, write_file
from rcs_data.errors import CorruptEpisode
from rcs_data.index import State
from rcs_data.info import DatasetInfo
from rcs_data.journal import Journal
from rcs_data.json_file import read_bytes
from rcs_data.layout import (
    ABORTED_FILE,
    DATASET_FILE,
    EPISODE_FILE,
    JOURNAL_FILE,
    ROWS_FILE,
    edit_number,
    episode_folder,
    folder_names,
    new_trash_folder,
    open_folder,
    open_ids,
    trash_folders,
)
from rcs_data.lock import DatasetLock

Leftovers = Literal["recover", "discard"]
"""What to do with episodes that were open when their writer died."""


@dataclass(frozen=True, kw_only=True)
class RecoverReport:
    """What `recover` did; all empty when there was nothing to do."""

    recovered: tuple[str, ...] = ()
    """Open episodes that are now complete, with success None and `outcome["recovered"]` True."""
    published: tuple[str, ...] = ()
    """Episodes that were finished and only lacked their final name."""
    removed: tuple[str, ...] = ()
    """Open episodes that had no rows, or were to be discarded."""
    failed: tuple[tuple[str, str], ...] = ()
    """Open episodes that were left alone, each with the reason."""

    def __str__(self) -> str:
        """Return one line per episode."""
        lines = [f"recovered {name}" for name in self.recovered]
        lines += [f"published {name}, which was already finished" for name in self.published]
        lines += [f"removed {name}" for name in self.removed]
        lines += [f"left {name} alone: {reason}" for name, reason in self.failed]
        return "\n".join(lines) or "nothing to recover"


def recover(path: str | Path) -> RecoverReport:
    """Complete the episodes that a dead writer left open, and return what was done; a second call does nothing.

    Args:
        path: The dataset's folder.

    Raises:
        DatasetError: There is no dataset, a living writer holds it, or the disk fails.
        CorruptEpisode: The index is damaged.
    """
    root = Path(path)
    Journal(root, is_whole=False)  # before anything is created
    with DatasetLock.writer(root):
        return settle_leftovers(Journal(root), "recover")


def settle_leftovers(journal: Journal, leftovers: Leftovers) -> RecoverReport:
    """Do what `recover` does, for a caller that holds the lock.

    Args:
        journal: The dataset's index.
        leftovers: Whether open episodes become complete ones or are removed; finished ones are always kept.

    Raises:
        DatasetError: The disk fails.
    """
    root, info = journal.root, journal.state.info
    done: dict[str, list[str]] = {"recovered": [], "published": [], "removed": []}
    failed: list[tuple[str, str]] = []
    with disk_errors("remove what discarded episodes left", root):
        garbage, unlisted = stray_folders(root, journal.state)
        for folder in (*trash_folders(root), *garbage):
            remove_tree(folder)
        for name in (DATASET_FILE, JOURNAL_FILE):
            (root / f"{name}.tmp").unlink(missing_ok=True)
        for folder in unlisted:
            try:
                about = read_about(folder)
            except CorruptEpisode as err:
                failed.append((folder.name, str(err)))
                continue
            if about["id"] in journal.state.episodes:
                failed.append((folder.name, f"the index has another episode {about['id']!r}"))
                continue
            journal.add(about, folder.name)
            done["published"].append(about["id"])
        write_description(root, info)
    for episode_id in open_ids(root):
        try:
            done[_settle(journal, info, episode_id, leftovers)].append(episode_id)
        except CorruptEpisode as err:
            failed.append((episode_id, str(err)))
    return RecoverReport(**{name: tuple(ids) for name, ids in done.items()}, failed=tuple(failed))


def write_description(root: Path, info: DatasetInfo) -> None:
    """Write `dataset.json` unless it is there already.

    Raises:
        OSError: The disk fails.
    """
    path, data = root / DATASET_FILE, sealed(info.to_json())
    if not path.is_file() or path.read_bytes() != data:
        write_file(path, data)
        sync_folder(root)


def stray_folders(root: Path, state: State) -> tuple[list[Path], list[Path]]:
    """Return the folders of episodes that the index does not have: garbage, and complete ones that it should have.

    A kill leaves them: of an edit before its line is in the index, of a removal after that, and of a recorded episode
    whose folder is in its place and not yet in the index.

    Args:
        root: The dataset's folder.
        state: What the index says.
    """
    known = state.folders()
    garbage: list[Path] = []
    unlisted: list[Path] = []
    for name in folder_names(root):
        if name in known:
            continue
        folder = episode_folder(root, name)
        is_garbage = edit_number(name) > 0 or _was_removed(folder, state)
        (garbage if is_garbage else unlisted).append(folder)
    return garbage, unlisted


def _was_removed(folder: Path, state: State) -> bool:
    """Return whether a folder is what was removed under its name, and not what was recorded since."""
    content_hash = state.removed.get(folder.name)
    if content_hash is None:
        return False
    try:
        return read_about(folder)["content_hash"] == content_hash
    except CorruptEpisode:
        return True


def _settle(journal: Journal, info: DatasetInfo, episode_id: str, leftovers: Leftovers) -> str:
    folder = open_folder(journal.root, episode_id)
    if folder.is_symlink() or not folder.is_dir():
        raise CorruptEpisode(f"{folder} is not a folder but {'a link' if folder.is_symlink() else 'a file'}")
    with disk_errors(f"recover episode {episode_id!r}", folder):
        (folder / f"{EPISODE_FILE}.tmp").unlink(missing_ok=True)
        (folder / f"{ABORTED_FILE}.tmp").unlink(missing_ok=True)
    if leftovers == "recover" and episode_id in journal.state.episodes:
        raise CorruptEpisode(
            f"there is a complete episode of the same name beside {folder}; `rcs-data check --repair` puts this one "
            "into quarantine"
        )
    if (folder / EPISODE_FILE).exists() and episode_id not in journal.state.episodes:
        publish(journal, episode_id)
        return "published"
    has_rows = (folder / ROWS_FILE).exists()
    if leftovers == "recover" and has_rows:
        outcome: dict[str, Any] = {"recovered": True, **_aborted(folder)}
        # The end was not measured; the rows have the time of the last one.
        if compact(journal, episode_id, info, success=None, outcome=outcome, ended=None) is not None:
            return "recovered"
    with disk_errors(f"remove episode {episode_id!r}", folder):
        remove_folder(folder, new_trash_folder(journal.root, episode_id))
    return "removed"


def _aborted(folder: Path) -> dict[str, Any]:
    path = folder / ABORTED_FILE
    try:
        if not path.exists():
            return {}
        return {"aborted": str(unsealed(read_bytes(path), path)["reason"])}
    except (CorruptEpisode, KeyError):
        return {"aborted": "for a reason that was not stored"}
