"""Repairs a dataset after its writer died: open episodes are completed, garbage is removed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rcs_data.compact import compact, publish
from rcs_data.durable import disk_errors, remove_folder, remove_tree, sync_folder, unsealed, write_file
from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.head import Head, read_head, read_head_file
from rcs_data.info import DatasetInfo
from rcs_data.json_file import read_bytes
from rcs_data.layout import (
    ABORTED_FILE,
    COPY_FILE,
    DATASET_FILE,
    EPISODE_FILE,
    ROWS_FILE,
    episode_folder,
    generation_folder,
    generations,
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
        CorruptEpisode: `dataset.json` is damaged.
    """
    root = Path(path)
    read_head(root)  # before anything is created
    with DatasetLock.writer(root):
        return settle_leftovers(root, read_head(root), "recover")


def settle_leftovers(root: Path, head: Head, leftovers: Leftovers) -> RecoverReport:
    """Do what `recover` does, for a caller that holds the lock.

    Args:
        root: The dataset's folder.
        head: The contents of `dataset.json`.
        leftovers: Whether open episodes become complete ones or are removed; finished ones are always kept.

    Raises:
        DatasetError: The disk fails.
    """
    with disk_errors("remove what discarded episodes left", root):
        base = generation_folder(root, head.generation)
        for folder in (*trash_folders(base), *unreachable_generations(root, head)):
            remove_tree(folder)
        for name in (DATASET_FILE, COPY_FILE):
            (root / f"{name}.tmp").unlink(missing_ok=True)
        _renew_copy(root)
    done: dict[str, list[str]] = {"recovered": [], "published": [], "removed": []}
    failed: list[tuple[str, str]] = []
    for episode_id in open_ids(base):
        try:
            done[_settle(base, head.info, episode_id, leftovers)].append(episode_id)
        except CorruptEpisode as err:
            failed.append((episode_id, str(err)))
    return RecoverReport(**{name: tuple(ids) for name, ids in done.items()}, failed=tuple(failed))


def _renew_copy(root: Path) -> None:
    """Update the copy of `dataset.json`, in case a kill came between the two.

    An old copy, read instead of a damaged `dataset.json`, would make the newest generation look like garbage.
    """
    try:
        read_head_file(root / DATASET_FILE)
    except (CorruptEpisode, DatasetError):
        return  # the copy is all that is left
    data = read_bytes(root / DATASET_FILE)
    if not (root / COPY_FILE).is_file() or (root / COPY_FILE).read_bytes() != data:
        write_file(root / COPY_FILE, data)
        sync_folder(root)


def unreachable_generations(root: Path, head: Head) -> list[Path]:
    """Return the folders of generations that the history does not mention, left by killed edits."""
    reachable = {head.generation, *(n for edit in head.history for n in (edit.before, edit.after))}
    return [generation_folder(root, n) for n in generations(root) if n not in reachable]


def _settle(base: Path, info: DatasetInfo, episode_id: str, leftovers: Leftovers) -> str:
    folder = open_folder(base, episode_id)
    if folder.is_symlink() or not folder.is_dir():
        raise CorruptEpisode(f"{folder} is not a folder but {'a link' if folder.is_symlink() else 'a file'}")
    with disk_errors(f"recover episode {episode_id!r}", folder):
        (folder / f"{EPISODE_FILE}.tmp").unlink(missing_ok=True)
        (folder / f"{ABORTED_FILE}.tmp").unlink(missing_ok=True)
    if episode_folder(base, episode_id).exists():
        raise CorruptEpisode(f"there is a complete episode of the same name beside {folder}")
    if (folder / EPISODE_FILE).exists():
        publish(base, episode_id)
        return "published"
    has_rows = (folder / ROWS_FILE).exists()
    if leftovers == "recover" and has_rows:
        outcome: dict[str, Any] = {"recovered": True, **_aborted(folder)}
        # The end was not measured; the rows have the time of the last one.
        if compact(base, episode_id, info, success=None, outcome=outcome, ended=None) is not None:
            return "recovered"
    with disk_errors(f"remove episode {episode_id!r}", folder):
        remove_folder(folder, new_trash_folder(base, episode_id))
    return "removed"


def _aborted(folder: Path) -> dict[str, Any]:
    path = folder / ABORTED_FILE
    try:
        if not path.exists():
            return {}
        return {"aborted": str(unsealed(read_bytes(path), path)["reason"])}
    except (CorruptEpisode, KeyError):
        return {"aborted": "for a reason that was not stored"}
