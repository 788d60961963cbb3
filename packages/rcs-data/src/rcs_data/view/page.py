"""The page: a folder with an `index.html` that opens from the disk, without a server and without a network."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rcs_data.durable import disk_errors, remove_tree
from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.feature import Feature
from rcs_data.json_file import parsed_json
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.view.catalogue import DAMAGED, catalogue
from rcs_data.view.choice import chosen_episodes
from rcs_data.view.clips import ClipOptions, pictures, write_clip
from rcs_data.view.episode_data import MOST_STEPS, curves, episode_data

VIEW_FOLDER = "view"
"""The page's folder in that of the dataset, where no other is given."""

WEB = Path(__file__).with_name("web")
_CATALOGUE = "dataset.js"
EPISODE_FILE = "episode.js"
# Part of the hash that decides whether an episode must be rendered anew: count up when what is rendered changes.
_FORMAT = 2
# The first line of an episode's file has a hash and some counts.
_LONGEST_HEAD = 4096


@dataclass(frozen=True, kw_only=True)
class ViewReport:
    """What `write_view` did."""

    path: Path
    """The page to open."""
    rendered: int
    """Episodes that were rendered now."""
    kept: int
    """Episodes that were there already."""
    damaged: int
    """Episodes that do not read; the page says so."""
    size: int
    """Bytes of all files."""


def write_view(
    dataset: Dataset | str | Path,
    out: str | Path | None = None,
    *,
    episodes: Sequence[str] | None = None,
    options: ClipOptions | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> ViewReport:
    """Write a page to look at a dataset with; of an earlier page in the same place, what still holds is kept.

    Args:
        dataset: The dataset, or its folder.
        out: The page's folder; None for `view` in the dataset's.
        episodes: Ids, or patterns such as "0001*", of the episodes to show; None for all.
        options: Size and codec of the clips.
        on_progress: Called with the episodes done and all that there are.

    Raises:
        InvalidSetup: No episode has one of the ids.
        DatasetError: There is no dataset, the folder has other things in it, or the page cannot be written.
        CorruptEpisode: `dataset.json` is damaged; damaged episodes are listed as such.
    """
    dataset = dataset if isinstance(dataset, Dataset) else Dataset.open(dataset)
    folder = dataset.path / VIEW_FOLDER if out is None else Path(out)
    options = options or ClipOptions()
    chosen = chosen_episodes(dataset, episodes)
    with disk_errors("write the page", folder):
        _require_own(folder)
        (folder / "episodes").mkdir(parents=True, exist_ok=True)
        # Until all episodes are there, so that a page that was not completed is known as one.
        _put(folder / _CATALOGUE, b"rcsDataset(null);\n")
        for source in sorted(WEB.iterdir()):
            _put(folder / source.name, source.read_bytes())
        _sweep(folder, {episode.id for episode in chosen})
        results = render(chosen, folder / "episodes", options, on_progress)
        entries = [(result.record, result.flaws, result.why) for result in results]
        values = catalogue(dataset, entries, [clip_name(feature) for feature in pictures(dataset.info)])
        _put(folder / _CATALOGUE, script("rcsDataset", values))
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return ViewReport(
        path=folder / "index.html",
        rendered=sum(result.is_new for result in results),
        kept=sum(not (result.is_new or result.why) for result in results),
        damaged=sum(result.why.startswith(DAMAGED) for result in results),
        size=size,
    )


def clip_name(feature: Feature) -> str:
    """Return the name of a feature's clips: words that need no escaping, and a few digits that tell twins apart."""
    words = feature.key.removeprefix("observation/").removeprefix("frames/")
    digits = hashlib.sha256(feature.key.encode()).hexdigest()[:4]
    return f"{re.sub(r'[^A-Za-z0-9]+', '-', words)[:60]}-{digits}.mp4"


@dataclass(frozen=True, kw_only=True)
class Rendered:
    """An episode whose files are there."""

    record: EpisodeRecord
    """The episode."""
    flaws: dict[str, int]
    """How many steps each kind of flaw has."""
    why: str = ""
    """Why the page does not show it, in words after its id; empty if it does."""
    is_new: bool = False
    """Whether it was rendered now."""


def render(
    episodes: Sequence[EpisodeRecord],
    folder: Path,
    options: ClipOptions,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[Rendered]:
    """Write the clips and curves of episodes, each into a folder of its id, unless they are there already.

    Args:
        episodes: The episodes.
        folder: Where their folders are.
        options: Size and codec of the clips.
        on_progress: Called with the episodes done and all that there are.
    """
    results: list[Rendered] = []
    # Decoding and encoding run without Python's lock.
    with ThreadPoolExecutor(min(8, os.cpu_count() or 1), "view") as pool:
        for result in pool.map(lambda episode: _render(episode, folder, options), episodes):
            results.append(result)
            if on_progress is not None:
                on_progress(len(results), len(episodes))
    return results


def _require_own(folder: Path) -> None:
    for path in (folder, folder / "episodes"):
        if path.is_symlink() or (path.exists() and not path.is_dir()):
            raise DatasetError(
                f"{path} is a link or no folder, and nothing is written through it; choose another with out."
            )
    if folder.exists() and any(folder.iterdir()) and not (folder / _CATALOGUE).exists():
        raise DatasetError(f"{folder} has other things in it; choose an empty folder, or one of an earlier page.")


def _sweep(folder: Path, ids: set[str]) -> None:
    """Remove the episodes that the page no longer shows, and what an interrupted call left."""
    for path in list((folder / "episodes").iterdir()):
        if path.name not in ids or path.is_symlink() or not path.is_dir():
            remove_tree(path)


def _render(record: EpisodeRecord, folder: Path, options: ClipOptions) -> Rendered:
    place = folder / record.id
    try:
        if record.length > MOST_STEPS:
            return Rendered(record=record, flaws={}, why=f"has {record.length} steps; a page shows up to {MOST_STEPS}.")
        key = _key(record, options)
        flaws = _flaws_of(place / EPISODE_FILE, key)
        if flaws is not None:
            return Rendered(record=record, flaws=flaws)
        # Ids do not start with a dot, so the next call takes what a kill leaves of this for rubbish.
        partial = place.with_name(f".partial-{hashlib.sha256(record.id.encode()).hexdigest()[:16]}")
        remove_tree(partial)
        partial.mkdir()
        values = episode_data(record)
        values["limits"] = [
            write_clip(record, feature, partial / clip_name(feature), options).limits
            for feature in pictures(record.info)
        ]
        head = json.dumps({"key": key, "flaws": values["flaws"]})
        body = script("rcsEpisode", {"id": record.id, **values})
        (partial / EPISODE_FILE).write_bytes(f"// {head}\n".encode() + body)
        remove_tree(place)
        partial.rename(place)
        return Rendered(record=record, flaws=values["flaws"], is_new=True)
    except CorruptEpisode as err:
        remove_tree(place)
        # Where the dataset lies on this machine is nothing for a page that is passed on.
        return Rendered(record=record, flaws={}, why=DAMAGED + str(err).replace(f"{record.path}/", ""))


def _key(record: EpisodeRecord, options: ClipOptions) -> str:
    """Return a hash of all that an episode's files depend on."""
    info = record.info
    about: dict[str, Any] = {
        "format": _FORMAT,
        "content": record.content_hash,
        "quality": record.timing,  # the content is without times and flags
        "length": record.length,
        "fps": info.frequency,
        "mode": [info.setup.get("mode"), info.sim_state_size],
        "features": [feature.to_json() for feature in info.features],
        "curves": [curve.to_json() for curve in curves(info)],
        "options": asdict(options),
    }
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()


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


def script(function: str, values: dict[str, Any]) -> bytes:
    """Return a script that calls a function with values."""
    # A page from the disk may load scripts but not read files, so the data come as a call. Pure ASCII, so no encoding
    # can be mistaken; and a script of its own, so nothing in it can end a tag.
    return f"{function}({json.dumps(values, allow_nan=False, separators=(',', ':'))});\n".encode("ascii")


def _put(path: Path, data: bytes) -> None:
    """Replace a file in one step; a page can be made again, so it need not outlive a power cut."""
    temporary = path.with_name(f".{path.name}.tmp")
    temporary.unlink(missing_ok=True)  # never through a link
    temporary.write_bytes(data)
    temporary.replace(path)
