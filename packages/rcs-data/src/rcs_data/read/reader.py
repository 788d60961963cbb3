"""Reads a dataset lazily: its episodes one by one, and only the parts of each that are used."""

from __future__ import annotations

import gc
import hashlib
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, SupportsIndex, overload

from rcs_data.errors import InvalidSetup
from rcs_data.files.layout import EPISODES_FOLDER
from rcs_data.index.history import Edit, history
from rcs_data.index.index import Index
from rcs_data.read.episode_record import EpisodeRecord as EpisodeRecord
from rcs_data.read.windows import Windows


class Dataset:
    """A dataset on disk, for reading, even while it is recorded.

    Examples:
        >>> dataset = Dataset("datasets/pick")  # doctest: +SKIP
        >>> dataset[3]["observation/joints"]  # doctest: +SKIP
        >>> loader = torch.utils.data.DataLoader(dataset.windows(history=2, actions=16))  # doctest: +SKIP
    """

    def __init__(self, path: str | Path, index: Index | None = None) -> None:
        """Open the dataset in a folder.

        Args:
            path: The folder.
            index: Its index, if the caller has read it already.

        Raises:
            DatasetError: There is no dataset, or its layout is of another version.
            CorruptEpisode: The index is damaged.
        """
        self.path = Path(path).absolute()  # a program may change its folder
        index = index or Index(self.path)
        self.info = index.info
        self.episodes = _records(self.path / EPISODES_FOLDER, index)
        """The complete episodes, sorted by id."""

    @classmethod
    def open(cls, path: str | Path) -> Dataset:
        """Open the dataset in a folder, as `Dataset(path)` does."""
        return cls(path)

    @cached_property
    def history(self) -> tuple[Edit, ...]:
        """The edits, oldest first.

        Raises:
            CorruptEpisode: The history is damaged.
        """
        return tuple(history(self.path))

    def windows(self, *, history: int = 1, actions: int = 16, **options: Any) -> Windows:
        """Return the windows of all steps for training: some observations up to a step, and the actions from it on.

        `torch.utils.data.DataLoader` takes them as they are; in a `ConcatDataset`, or with `batch_size=None`, it takes
        `rcs_data.TorchDataset(windows)`.

        Args:
            history: Observations in a window.
            actions: Actions in a window.
            options: Other arguments of `rcs_data.Windows`: cameras, episodes, image_size, stride, and so on.

        Raises:
            InvalidSetup: An argument does not make sense, or there is no window.
        """
        return Windows(self, history=history, horizon=actions, **options)

    def digest(self) -> str:
        """Return one SHA-256 over all episodes without times and flags, equal for two runs of one collection."""
        total = hashlib.sha256()
        for entry in (episode.entry for episode in self.episodes):
            total.update(f"{entry.id} {entry.content_hash}\n".encode())
        return total.hexdigest()

    def __repr__(self) -> str:
        return f"Dataset({str(self.path)!r}, {len(self)} episodes)"

    def __iter__(self) -> Iterator[EpisodeRecord]:
        return iter(self.episodes)

    def __contains__(self, episode: object) -> bool:
        """Return whether the dataset has a complete episode, given its id or record."""
        if isinstance(episode, EpisodeRecord):
            return episode in self.episodes
        return episode in self._by_id

    def __len__(self) -> int:
        return len(self.episodes)

    @overload
    def __getitem__(self, episode: str | SupportsIndex) -> EpisodeRecord: ...
    @overload
    def __getitem__(self, episode: slice) -> tuple[EpisodeRecord, ...]: ...
    def __getitem__(self, episode: str | SupportsIndex | slice) -> EpisodeRecord | tuple[EpisodeRecord, ...]:
        """Return the episode with an id, or at a place in the order of the ids, or all episodes of a slice.

        Raises:
            InvalidSetup: No episode has the id.
            IndexError: No episode is at the place.
        """
        if not isinstance(episode, str) and (isinstance(episode, slice) or hasattr(episode, "__index__")):
            return self.episodes[episode]
        try:
            return self._by_id[str(episode)]
        except KeyError:
            known = f"which has {len(self)} episodes"
            raise InvalidSetup(f"There is no episode {episode!r} in {self.path}, {known}.") from None

    @cached_property
    def _by_id(self) -> dict[str, EpisodeRecord]:
        return {episode.id: episode for episode in self.episodes}


def _records(folder: Path, index: Index) -> tuple[EpisodeRecord, ...]:
    """Return the records of all episodes by id, without garbage collections, which would take longer than the rest."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        entries = map(index.entries.__getitem__, sorted(index.entries))
        return tuple([EpisodeRecord(f"{folder}/{entry.folder}", index.info, entry) for entry in entries])
    finally:
        if was_on:
            gc.enable()
