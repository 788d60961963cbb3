"""Renders episodes for a page: the curves and marks of each in one file, and a clip per camera, made once."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from rcs_data.durable import remove_tree
from rcs_data.errors import CorruptEpisode
from rcs_data.feature import Feature
from rcs_data.json_file import parsed_json
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.view.clips import ClipOptions, pictures, write_clip
from rcs_data.view.episode_data import MOST_STEPS, curves, episode_data, is_faster_than_life
from rcs_data.view.html import json_text

EPISODES, CLIPS = "episodes", "clips"
"""Folders of a page: a script for each episode, and a folder for the clips of each."""

# Part of the hash that decides whether an episode must be rendered anew: count up when what is rendered changes.
_FORMAT = 3
# The first line of an episode's file has a hash and some counts.
_LONGEST_HEAD = 4096


@dataclass(frozen=True, kw_only=True)
class Rendered:
    """An episode whose files are there, or the reason why they are not."""

    record: EpisodeRecord
    flaws: dict[str, int]
    """How many steps each kind of flaw has."""
    why: str = ""
    """Why the page does not show it, in words after its id; empty if it does."""
    is_new: bool = False
    is_damaged: bool = False


@dataclass(frozen=True, kw_only=True)
class Renderer:
    """Writes what a page shows of episodes, unless it is there already."""

    dataset: Dataset
    """Whose episodes they are."""
    folder: Path
    """The page's, with the folders for scripts and clips."""
    options: ClipOptions
    """Size and codec of the clips."""

    def render(self, episodes: Iterable[EpisodeRecord]) -> Iterator[Rendered]:
        """Render episodes side by side, and yield them in their order, as they are done."""
        if not self._pictures:  # only decoding and encoding run without Python's lock
            yield from map(self._render, episodes)
            return
        workers = min(8, os.cpu_count() or 1)
        under_way: deque[Future[Rendered]] = deque()
        with ThreadPoolExecutor(workers, "view") as pool:
            for episode in episodes:
                under_way.append(pool.submit(self._render, episode))
                if len(under_way) > 2 * workers:
                    yield under_way.popleft().result()
            while under_way:
                yield under_way.popleft().result()

    def _render(self, record: EpisodeRecord) -> Rendered:
        script, clips = episode_file(self.folder, record), self.folder / CLIPS / record.id
        try:
            if record.length > MOST_STEPS:
                why = f"has {record.length} steps; a page shows up to {MOST_STEPS}."
                return Rendered(record=record, flaws={}, why=why)
            key = self._key(record)
            flaws = _flaws_of(script, key)
            if flaws is not None:
                return Rendered(record=record, flaws=flaws)
            script.unlink(missing_ok=True)  # it comes last, so that what a kill leaves is not taken for whole
            remove_tree(clips)
            values: dict[str, Any] = {"id": record.id, **episode_data(record), "limits": []}
            if self._pictures:
                clips.mkdir()
            for feature in self._pictures:
                values["limits"].append(write_clip(record, feature, clips / clip_name(feature), self.options))
            head = json.dumps({"key": key, "flaws": values["flaws"]})
            put(script, f"// {head}\nrcsEpisode({json_text(values)});\n".encode("ascii"))
            return Rendered(record=record, flaws=values["flaws"], is_new=True)
        except CorruptEpisode as err:
            script.unlink(missing_ok=True)
            remove_tree(clips)
            # Where the dataset lies on this machine is nothing for a page that is passed on.
            why = str(err).replace(f"{self.dataset.path / EPISODES}/", "").replace(f"{self.dataset.path}/", "")
            return Rendered(record=record, flaws={}, why=f"is damaged: {why}", is_damaged=True)

    @cached_property
    def _pictures(self) -> list[Feature]:
        return pictures(self.dataset.info)

    @cached_property
    def _form(self) -> str:
        """All that the files of every episode depend on."""
        info = self.dataset.info
        about: dict[str, Any] = {
            "format": _FORMAT,
            "fps": info.frequency,
            "has_periods": not is_faster_than_life(info),
            "features": [feature.to_json() for feature in info.features],
            "curves": [curve.to_json() for curve in curves(info)],
            "options": asdict(self.options),
        }
        return json.dumps(about, sort_keys=True)

    def _key(self, record: EpisodeRecord) -> str:
        """Return a hash of all that an episode's files depend on; the content hash is without times and flags."""
        own = json.dumps([record.content_hash, record.length, record.timing], sort_keys=True)
        return hashlib.sha256(f"{self._form}{own}".encode()).hexdigest()


def episode_file(folder: Path, record: EpisodeRecord) -> Path:
    """Return the script of an episode."""
    return folder / EPISODES / f"{record.id}.js"


def clip_name(feature: Feature) -> str:
    """Return the name of a feature's clips: words that need no escaping, and a few digits that tell twins apart."""
    words = feature.key.removeprefix("observation/").removeprefix("frames/")
    digits = hashlib.sha256(feature.key.encode()).hexdigest()[:4]
    return f"{re.sub(r'[^A-Za-z0-9]+', '-', words)[:60]}-{digits}.mp4"


def put(path: Path, data: bytes) -> None:
    """Replace a file in one step; a page can be made again, so it need not outlive a power cut."""
    temporary = path.with_name(f".{hashlib.sha256(path.name.encode()).hexdigest()[:16]}.tmp")
    temporary.unlink(missing_ok=True)  # never through a link
    temporary.write_bytes(data)
    temporary.replace(path)


def sweep(folder: Path, episodes: Iterable[EpisodeRecord]) -> None:
    """Remove what a page no longer shows, and what an interrupted call left."""
    ids = {episode.id for episode in episodes}
    for path in list((folder / EPISODES).iterdir()):
        if path.name.removesuffix(".js") not in ids or not path.name.endswith(".js") or not path.is_file():
            remove_tree(path)
    for path in list((folder / CLIPS).iterdir()):
        if path.name not in ids or path.is_symlink() or not path.is_dir():
            remove_tree(path)


def _flaws_of(path: Path, key: str) -> dict[str, int] | None:
    """Return the flaws that a rendered episode names in its first line; None if it is not there or out of date."""
    try:
        with path.open("rb") as file:
            head = parsed_json(file.readline(_LONGEST_HEAD).removeprefix(b"// "), path)
    except (OSError, CorruptEpisode):
        return None
    flaws = head.get("flaws")
    is_right = isinstance(flaws, dict) and all(type(count) is int for count in flaws.values())
    return flaws if head.get("key") == key and is_right else None
