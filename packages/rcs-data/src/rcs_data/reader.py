"""Reads a dataset lazily: its episodes one by one, and only the parts of each that are used."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import pyarrow as pa

from rcs_data.episode_record import EpisodeRecord as EpisodeRecord
from rcs_data.episode_record import last_valid
from rcs_data.errors import InvalidSetup
from rcs_data.index import Edit, State
from rcs_data.journal import Journal
from rcs_data.layout import episodes_folder


class Dataset:
    """A dataset on disk, for reading; one that is being recorded can be read too."""

    def __init__(self, path: Path, state: State | None = None) -> None:
        """Hold a dataset; use `open` to get one.

        Args:
            path: The folder.
            state: What the index says.

        Raises:
            InvalidSetup: There is no state.
        """
        if state is None:
            raise InvalidSetup(f"Dataset(...) holds what is open; open a dataset with Dataset.open({str(path)!r}).")
        self.path = path
        self.info = state.info
        self.history: tuple[Edit, ...] = tuple(state.history)
        """The edits, oldest first."""
        folder = episodes_folder(path)
        self.episodes = tuple(
            EpisodeRecord(folder / entry.folder, state.info, entry) for _, entry in sorted(state.episodes.items())
        )
        """The complete episodes, sorted by id."""

    @classmethod
    def open(cls, path: str | Path) -> Dataset:
        """Open the dataset in a folder.

        Raises:
            DatasetError: There is no dataset, or its layout is of another version.
            CorruptEpisode: The index is damaged.
        """
        root = Path(path).absolute()  # a program may change its folder
        return cls(root, Journal(root).state)

    def digest(self) -> str:
        """Return one SHA-256 over all episodes except times and flags: equal for two runs of one collection."""
        total = hashlib.sha256()
        for episode in self.episodes:
            total.update(f"{episode.id} {episode.content_hash}\n".encode())
        return total.hexdigest()

    def to_arrow(self, keys: list[str] | None = None) -> pa.Table:
        """Return all columns of numbers of all episodes as one table, preceded by "episode" (id) and "row".

        Held values are filled in. A missing value, such as the first row's action, is null.

        Args:
            keys: The columns to read; None for all but images.

        Raises:
            InvalidSetup: There is no such feature, or it is an image.
            CorruptEpisode: An episode is damaged.
        """
        features = [f for f in self.info.features if not f.is_image] if keys is None else map(self.info.feature, keys)
        chosen = {feature.key: feature for feature in features}
        images = [key for key, feature in chosen.items() if feature.is_image]
        if images:
            raise InvalidSetup(
                f"{', '.join(images)}: image columns cannot be tabulated; read them with `FrameAccess` or `frames`."
            )
        fields = [pa.field("episode", pa.string()), pa.field("row", pa.int64())]
        tables = [pa.schema([*fields, *(feature.arrow_field for feature in chosen.values())]).empty_table()]
        for episode in self.episodes:
            rows = episode.steps(list(chosen))
            columns = [rows.column(key) for key in chosen]
            whole = [
                c.take(pa.array(last_valid(c))) if chosen[k].can_be_held else c
                for k, c in zip(chosen, columns, strict=True)
            ]
            place = [pa.array([episode.id] * len(rows), pa.string()), pa.array(range(len(rows)), pa.int64())]
            tables.append(pa.Table.from_arrays([*place, *whole], schema=tables[0].schema))
        return pa.concat_tables(tables)

    def __repr__(self) -> str:
        return f"Dataset({str(self.path)!r}, {len(self)} episodes)"

    def _repr_html_(self) -> str:
        from rcs_data.view.notebook import dataset_html  # which reads datasets itself

        return dataset_html(self)

    def __iter__(self) -> Iterator[EpisodeRecord]:
        return iter(self.episodes)

    def __contains__(self, episode: object) -> bool:
        """Return whether the dataset has a complete episode, given its id or record."""
        if isinstance(episode, EpisodeRecord):
            return episode in self.episodes
        return episode in self._by_id

    def __len__(self) -> int:
        return len(self.episodes)

    def __getitem__(self, episode_id: str) -> EpisodeRecord:
        """Return the episode with this id.

        Raises:
            InvalidSetup: There is none.
        """
        try:
            return self._by_id[episode_id]
        except KeyError:
            known = f"which has {len(self)} episodes"
            raise InvalidSetup(f"There is no episode {episode_id!r} in {self.path}, {known}.") from None

    @cached_property
    def _by_id(self) -> dict[str, EpisodeRecord]:
        return {episode.id: episode for episode in self.episodes}
