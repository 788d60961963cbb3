"""Takes in a complete episode that was recorded into another dataset of the same info, as on another machine."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

from rcs_data.about import checked_about
from rcs_data.compact import publish
from rcs_data.durable import HashedFile, disk_errors, remove_folder, sync_folder, unsealed, write_file
from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.info import DatasetInfo
from rcs_data.layout import (
    EPISODE_FILE,
    FRAMES_FILE,
    STEPS_FILE,
    check_episode_id,
    episode_folder,
    new_trash_folder,
    open_folder,
)

Files = Mapping[str, bytes | memoryview]
"""The contents of files by name."""


def adopt(base: Path, info: DatasetInfo, episode_id: str, files: Files) -> Path:
    """Write an episode's files into a dataset, byte for byte, and return its folder.

    A kill leaves an open episode without rows, which the next writer removes, or a complete one.

    Args:
        base: The folder that has the current episodes.
        info: What the dataset's episodes share; that of the dataset that the episode was recorded into is equal.
        episode_id: The episode. No writer may be recording it; what a dead one left of it is removed.
        files: All files of its folder.

    Raises:
        InvalidSetup: The id cannot be the name of a folder.
        CorruptEpisode: The files are not what was written, or not those of this episode of such a dataset.
        DatasetError: There is such an episode already, or the disk fails.
    """
    check_episode_id(episode_id)
    expected = {EPISODE_FILE, STEPS_FILE, *([FRAMES_FILE] if info.has_images else [])}
    if set(files) != expected:
        raise CorruptEpisode(
            f"Episode {episode_id!r} came with the files {', '.join(sorted(files)) or '(none)'}; "
            f"an episode of this dataset has {', '.join(sorted(expected))}."
        )
    folder = open_folder(base, episode_id)
    description = bytes(files[EPISODE_FILE])
    about = checked_about(unsealed(description, folder / EPISODE_FILE), folder / EPISODE_FILE)
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in files.items() if name != EPISODE_FILE}
    if about["id"] != episode_id or about["sha256"] != hashes:
        raise CorruptEpisode(f"Episode {episode_id!r} did not arrive as it was written: an id or a hash differs.")
    if episode_folder(base, episode_id).exists():
        raise DatasetError(f"There already is an episode {episode_id!r} in {base}; remove it, or choose another id.")
    with disk_errors(f"write episode {episode_id!r}", folder):
        if folder.exists():
            remove_folder(folder, new_trash_folder(base, episode_id))
        folder.mkdir()
        for name in hashes:
            file = HashedFile(folder / name)
            try:
                file.write(files[name])
                file.complete()
            finally:
                file.close()
        write_file(folder / EPISODE_FILE, description)
        sync_folder(folder)
    return publish(base, episode_id)
