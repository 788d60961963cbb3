"""Completes a dataset after its writer died: open episodes become whole ones, garbage is removed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rcs_data.errors import CorruptEpisode
from rcs_data.files.about import read_about
from rcs_data.files.durable import disk_errors, remove_folder, remove_tree, unsealed
from rcs_data.files.json_file import read_bytes
from rcs_data.files.layout import (
    ABORTED_FILE,
    DATASET_FILE,
    EPISODE_FILE,
    EPISODES_FOLDER,
    INDEX_FILE,
    OPEN_FOLDER,
    ROWS_FILE,
    folder_names,
    new_trash,
    removals,
    trash,
)
from rcs_data.index.history import edits_in_force, locked, relabelled
from rcs_data.index.index import Index
from rcs_data.record.compact import compact, publish

Leftovers = Literal["recover", "discard"]
"""Treatment of episodes that were open when their writer died."""
CUT = ", up to the last row that can be read; its stream is in quarantine"
"""Words on an episode whose stream could not be read to its end."""


@dataclass(frozen=True, kw_only=True)
class RecoverReport:
    """The results of `recover`; all empty when there was nothing to do."""

    recovered: tuple[str, ...] = ()
    """Open episodes that are now complete, with success None and `outcome["recovered"]` True."""
    cut: tuple[str, ...] = ()
    """Those of them whose rows could not be read to the end; the stream of all their rows is in `quarantine/`."""
    published: tuple[str, ...] = ()
    """Episodes that were finished and only lacked their final name."""
    removed: tuple[str, ...] = ()
    """Open episodes that had no rows, or were to be discarded."""
    failed: tuple[tuple[str, str], ...] = ()
    """Open episodes that were left alone, each with the reason."""

    def __str__(self) -> str:
        """Return one line per episode."""
        lines = [f"recovered {name}{CUT * (name in self.cut)}" for name in self.recovered]
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
    with locked(Path(path)) as index:
        return settle_leftovers(index, "recover")


def settle_leftovers(index: Index, leftovers: Leftovers) -> RecoverReport:
    """Do what `recover` does, for a caller that holds the lock.

    Args:
        index: The dataset's index.
        leftovers: Whether open episodes become complete ones or are removed; finished ones are always kept.

    Raises:
        DatasetError: The disk fails.
        CorruptEpisode: The history is damaged, and an episode that is not in the index may have got another label.
    """
    root = index.root
    done: dict[str, list[str]] = {"recovered": [], "published": [], "removed": []}
    failed: list[tuple[str, str]] = []
    with disk_errors("remove what discarded episodes left", root):
        _finish_removals(index)
        for path in (*trash(root), *(root / f"{name}.tmp" for name in (DATASET_FILE, INDEX_FILE))):
            remove_tree(path)
        folders = unlisted(index)
        edits = edits_in_force(root) if folders else []
        for folder in folders:
            try:
                about = read_about(folder)
                if about["id"] in index.entries:
                    raise CorruptEpisode(f"the index has another episode {about['id']!r}")
            except CorruptEpisode as err:
                failed.append((folder.name, str(err)))
                continue
            index.add(relabelled(about, folder.name, edits), folder.name)
            done["published"].append(about["id"])
    for episode_id in folder_names(root, OPEN_FOLDER):
        try:
            done[_settle(index, episode_id, leftovers)].append(episode_id)
        except CorruptEpisode as err:
            failed.append((episode_id, str(err)))
    cut = tuple(name for name in done["recovered"] if _is_torn(index, name))
    return RecoverReport(**{name: tuple(ids) for name, ids in done.items()}, cut=cut, failed=tuple(failed))


def unlisted(index: Index) -> list[Path]:
    """Return the folders of complete episodes that the index does not have, since a kill prevented their line.

    Args:
        index: The dataset's index.
    """
    known = {entry.folder for entry in index.entries.values()}
    return [index.root / EPISODES_FOLDER / name for name in folder_names(index.root) if name not in known]


def _finish_removals(index: Index) -> None:
    """Remove the folders of episodes that a killed program was removing, if they are out of the index."""
    listed = {entry.folder for entry in index.entries.values()}
    for mark, folder in removals(index.root).items():
        if folder.name not in listed and folder.is_dir():
            remove_folder(folder, new_trash(index.root, folder.name))
        mark.unlink()


def _is_torn(index: Index, episode_id: str) -> bool:
    about = read_about(index.root / EPISODES_FOLDER / index.entries[episode_id].folder)
    return bool(about["timing"].get("is_torn"))


def _settle(index: Index, episode_id: str, leftovers: Leftovers) -> str:
    folder = index.root / OPEN_FOLDER / episode_id
    if folder.is_symlink() or not folder.is_dir():
        raise CorruptEpisode(f"{folder} is not a folder but {'a link' if folder.is_symlink() else 'a file'}")
    with disk_errors(f"recover episode {episode_id!r}", folder):
        (folder / f"{EPISODE_FILE}.tmp").unlink(missing_ok=True)
        (folder / f"{ABORTED_FILE}.tmp").unlink(missing_ok=True)
    if leftovers == "recover" and episode_id in index.entries:
        raise CorruptEpisode(
            f"there is a complete episode of the same name beside {folder}; `rcs-data check --repair` puts this one "
            "into quarantine"
        )
    if (folder / EPISODE_FILE).exists() and episode_id not in index.entries:
        publish(index, episode_id)
        return "published"
    has_rows = (folder / ROWS_FILE).exists()
    if leftovers == "recover" and has_rows:
        outcome: dict[str, Any] = {"recovered": True, **_aborted(folder)}
        # The end was not measured; the rows have the time of the last one.
        if compact(index, episode_id, success=None, outcome=outcome, ended=None) is not None:
            return "recovered"
    with disk_errors(f"remove episode {episode_id!r}", folder):
        remove_folder(folder, new_trash(index.root, episode_id))
    return "removed"


def _aborted(folder: Path) -> dict[str, Any]:
    path = folder / ABORTED_FILE
    try:
        if not path.exists():
            return {}
        return {"aborted": str(unsealed(read_bytes(path), path)["reason"])}
    except (CorruptEpisode, KeyError):
        return {"aborted": "for a reason that was not stored"}
