"""Undoes edits, or prunes what undo needs."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

from rcs_data.durable import disk_errors
from rcs_data.edit.transaction import now
from rcs_data.errors import DatasetError
from rcs_data.head import Edit, Head, read_head, write_head
from rcs_data.info import DatasetInfo
from rcs_data.layout import complete_ids, episodes_folder, generation_folder, generations, open_ids
from rcs_data.lock import DatasetLock

UNDO = "undo"


def undo(path: str | Path) -> Edit:
    """Undo the last edit that is not undone yet, and return it.

    Args:
        path: The dataset.

    Raises:
        DatasetError: There is nothing to undo, the former episodes were pruned, episodes were recorded since, or
            another process writes to the dataset; nothing changes.
        CorruptEpisode: The dataset is damaged.
    """
    root = Path(path)
    read_head(root)
    with DatasetLock.writer(root):
        head = read_head(root)
        edit = _edit_to(head)
        if edit is None:
            raise DatasetError(f"There is nothing to undo in {root}: its episodes are as they were recorded.")
        base, former = (generation_folder(root, n) for n in (head.generation, edit.before))
        if not episodes_folder(former).exists():
            raise DatasetError(f"Cannot undo {edit.command!r} of {edit.at}: the former episodes of {root} were pruned.")
        if since := sorted({*complete_ids(base), *open_ids(base)} - set(edit.episodes)):
            raise DatasetError(
                f"Episodes {', '.join(since[:5])} were recorded into {root} since {edit.command!r}; undo would lose "
                "them. Split them off first, or delete what you do not want."
            )
        line = replace(
            edit,
            command=UNDO,
            arguments={"command": edit.command, "at": edit.at},
            at=now(),
            before=edit.after,
            after=edit.before,
            episodes=tuple(complete_ids(former)),
            info=head.info.to_json(),
        )
        info = DatasetInfo.from_json(edit.info)
        with disk_errors("undo", root):
            write_head(root, Head(info=info, generation=edit.before, history=(*head.history, line)))
        return edit


def prune(path: str | Path) -> int:
    """Remove the episodes of former generations for good, and return the bytes freed.

    The history stays, but the edits in it can no longer be undone.

    Args:
        path: The dataset.

    Raises:
        DatasetError: Another process writes to the dataset, or the disk fails.
        CorruptEpisode: The dataset is damaged.
    """
    root = Path(path)
    read_head(root)
    with DatasetLock.writer(root):
        head = read_head(root)
        with disk_errors("prune", root):
            former = [generation for generation in (0, *generations(root)) if generation != head.generation]
            kept = _files([generation_folder(root, head.generation)])
            freed = _files([generation_folder(root, generation) for generation in former])
            for generation in former:
                folder = episodes_folder(generation_folder(root, generation))
                shutil.rmtree(folder if generation == 0 else folder.parent, ignore_errors=True)
        return sum(size for file, size in freed.items() if file not in kept)


def _files(bases: list[Path]) -> dict[int, int]:
    """Return the size of each file of the episodes by inode."""
    paths = [path for base in bases for path in episodes_folder(base).rglob("*") if path.is_file()]
    return {about.st_ino: about.st_size for about in (path.stat() for path in paths)}


def _edit_to(head: Head) -> Edit | None:
    """Return the edit that made the current generation; None if it was recorded."""
    made = [edit for edit in head.history if edit.command != UNDO and edit.after == head.generation]
    return made[-1] if made else None
