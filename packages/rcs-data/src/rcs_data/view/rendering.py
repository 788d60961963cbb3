"""Renders episodes for a page: the curves and marks of each in one file, and a clip per camera.

The file has a hash of all that it and the clips follow from, and is written last; so what an earlier page has of an
episode that did not change is kept.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from rcs_data.errors import CorruptEpisode
from rcs_data.files.durable import remove_tree
from rcs_data.files.feature import Feature
from rcs_data.read.reader import Dataset, EpisodeRecord
from rcs_data.view.clips import ClipOptions, pictures, write_clip
from rcs_data.view.episode_data import MOST_STEPS, episode_data, is_faster_than_life
from rcs_data.view.html import json_text

EPISODES, CLIPS = "episodes", "clips"
"""Folders of a page: a script for each episode, and a folder for the clips of each."""


@dataclass(frozen=True, kw_only=True)
class Rendered:
    """An episode whose files are there, or the reason why they are not."""

    record: EpisodeRecord
    flaws: dict[str, int]
    """How many steps each kind of flaw has."""
    why: str = ""
    """Why the page does not show it, in words after its id; empty if it does."""
    is_damaged: bool = False


@dataclass(frozen=True, kw_only=True)
class Renderer:
    """Writes what a page shows of episodes."""

    dataset: Dataset
    """Whose episodes they are."""
    folder: Path
    """The page's, with folders for scripts and clips."""
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
        clips, script = self.folder / CLIPS / record.id, episode_file(self.folder, record)
        try:
            about = record.about
            key = self._key(about)
            if (flaws := self._kept(script, clips, key)) is not None:
                return Rendered(record=record, flaws=flaws)
            remove_tree(script)
            remove_tree(clips)
            if record.length > MOST_STEPS:
                why = f"has {record.length} steps; a page shows up to {MOST_STEPS}."
                return Rendered(record=record, flaws={}, why=why)
            values: dict[str, Any] = {"id": about["id"], "key": key, **episode_data(record), "limits": []}
            if self._pictures:
                clips.mkdir()
            for feature in self._pictures:
                values["limits"].append(write_clip(record, feature, clips / clip_name(feature), self.options))
            script.write_text(f"rcsEpisode({json_text(values)});\n", "ascii")
            return Rendered(record=record, flaws=values["flaws"])
        except CorruptEpisode as err:
            remove_tree(script)
            remove_tree(clips)
            # Where the dataset lies on this machine is nothing for a page that is passed on.
            why = str(err).replace(f"{self.dataset.path / EPISODES}/", "").replace(f"{self.dataset.path}/", "")
            return Rendered(record=record, flaws={}, why=f"is damaged: {why}", is_damaged=True)

    def _key(self, about: dict[str, Any]) -> str:
        """Return a hash of what an episode looks like: its files, how its numbers are meant, and how it is drawn."""
        info = self.dataset.info
        meaning = info.frequency, info.features, is_faster_than_life(info)
        whole = about["id"], sorted(about["sha256"].items()), meaning, self.options, _program()
        return hashlib.sha256(repr(whole).encode()).hexdigest()

    def _kept(self, script: Path, clips: Path, key: str) -> dict[str, int] | None:
        """Return the flaws of an episode whose files are there and have the key; None if they are to be made."""
        try:
            values = json.loads(script_values(script))
        except (OSError, ValueError):  # not there, or cut short
            return None
        is_whole = all((clips / clip_name(feature)).is_file() for feature in self._pictures)
        return values["flaws"] if is_whole and values.get("key") == key else None

    @cached_property
    def _pictures(self) -> list[Feature]:
        return pictures(self.dataset.info)


@cache
def _program() -> str:
    """Return a hash of the code that draws."""
    sources = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()


def script_values(script: Path) -> str:
    """Return the values in the script of an episode, as JSON."""
    return script.read_text("ascii").strip().removeprefix("rcsEpisode(").removesuffix(");")


def episode_file(folder: Path, record: EpisodeRecord) -> Path:
    """Return the script of an episode."""
    return folder / EPISODES / f"{record.id}.js"


def clip_name(feature: Feature) -> str:
    """Return the name of a feature's clips: words that need no escaping, and a few digits that distinguish twins."""
    words = feature.key.removeprefix("observation/").removeprefix("frames/")
    digits = hashlib.sha256(feature.key.encode()).hexdigest()[:4]
    return f"{re.sub(r'[^A-Za-z0-9]+', '-', words)[:60]}-{digits}.mp4"
