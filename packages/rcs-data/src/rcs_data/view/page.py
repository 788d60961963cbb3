"""The page: a folder with an `index.html`, or one file that can be passed on; both open without server and network."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import chain
from pathlib import Path

from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.files.durable import disk_errors, remove_tree, write_file
from rcs_data.files.output import OnProgress, size_on_disk
from rcs_data.read.reader import Dataset, EpisodeRecord
from rcs_data.view.catalogue import catalogue
from rcs_data.view.clips import ClipOptions, pictures
from rcs_data.view.html import Html, element, page, script, style, web
from rcs_data.view.rendering import CLIPS, EPISODES, Rendered, Renderer, clip_name, episode_file, script_values

VIEW_FOLDER = "view"
"""The page's folder in that of the dataset, where no other is given."""

REPORT_FILE = "report.html"

# Smaller than those of the page in a folder: about 60 kB for a camera and four seconds.
_CLIPS = ClipOptions(height=224, quality=30, whole_frame_every=30)
# So many of the first episodes, and of all episodes that failed, are in the page with clips and curves.
_FIRST_IN_DETAIL = 20
_MOST_IN_DETAIL = 120
_LEFT_OUT = "was left out, but for its outcome, to keep this file small; `rcs-data view` shows all episodes."
_EPISODES_HERE = Html("<!-- episodes -->")
_CATALOGUE = "dataset.js"
_STYLE = "viewer.css"
_SCRIPTS = ("plots.js", "player.js", "catalogue.js", "viewer.js")


@dataclass(frozen=True, kw_only=True)
class ViewReport:
    """The result of `write_view`."""

    path: Path
    """The page to open."""
    rendered: int
    """Episodes that it shows."""
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
    on_progress: OnProgress | None = None,
) -> ViewReport:
    """Write a page to look at a dataset with, in place of an earlier one.

    Episodes that did not change since that one are not rendered again.

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
    chosen = chosen_episodes(dataset, episodes)
    counts = {"rendered": 0, "damaged": 0}

    def counted() -> Iterator[Rendered]:
        renderer = Renderer(dataset=dataset, folder=folder, options=options or ClipOptions())
        for number, result in enumerate(renderer.render(chosen)):
            counts["rendered"] += not result.why
            counts["damaged"] += result.is_damaged
            if on_progress is not None:
                on_progress(number + 1, len(chosen))
            yield result

    with disk_errors("write the page", folder):
        _require_own(folder)
        folder.mkdir(parents=True, exist_ok=True)
        # Until all episodes are there, so that a page that was not completed is known as one.
        write_file(folder / _CATALOGUE, b"rcsDataset(null);\n")
        shown = {record.id for record in chosen}
        for name, ending in ((EPISODES, ".js"), (CLIPS, "")):
            (folder / name).mkdir(exist_ok=True)
            for path in (folder / name).iterdir():
                if path.name.removesuffix(ending) not in shown:
                    remove_tree(path)
        write_file(folder / "index.html", shell(is_alone=False).encode())
        for name in (_STYLE, *_SCRIPTS):
            write_file(folder / name, web(name).encode())
        write_file(folder / _CATALOGUE, more=catalogue(dataset, counted()))
        return ViewReport(path=folder / "index.html", size=size_on_disk(folder), **counts)


def shell(*, is_alone: bool, more: Html | None = None) -> Html:
    """Return the page without its dataset; alone, style and scripts are in it. `more` replaces the dataset's script."""
    assets = style() if is_alone else element("link", rel="stylesheet", href=_STYLE)
    scripts = [script(web(name)) if is_alone else element("script", src=name) for name in _SCRIPTS]
    return page("Dataset", Html(web("body.html")), *scripts, more or element("script", src=_CATALOGUE), assets=assets)


def chosen_episodes(dataset: Dataset, patterns: Sequence[str] | None) -> tuple[EpisodeRecord, ...]:
    """Return the episodes that are meant by ids, or patterns such as "0001*", in the dataset's order; None for all.

    Raises:
        InvalidSetup: No episode fits one of them.
    """
    if patterns is None:
        return tuple(dataset.episodes)
    fits = {
        pattern: {e.id for e in dataset.episodes if e.id == pattern or fnmatchcase(e.id, pattern)}
        for pattern in patterns
    }
    if none := [pattern for pattern, ids in fits.items() if not ids]:
        raise InvalidSetup(f"No episode of {dataset.path} is named {none[0]!r}; it has {len(dataset)} episodes.")
    meant = set().union(*fits.values())
    return tuple(episode for episode in dataset.episodes if episode.id in meant)


def _require_own(folder: Path) -> None:
    for path in (folder, folder / EPISODES, folder / CLIPS):
        if path.is_symlink() or (path.exists() and not path.is_dir()):
            raise DatasetError(
                f"{path} is a link or no folder, and nothing is written through it; choose another with out."
            )
    there = {path.name for path in folder.iterdir()} if folder.exists() else set[str]()
    if there - {f"{_CATALOGUE}.tmp"} and _CATALOGUE not in there:  # what a kill may leave of the first file
        raise DatasetError(f"{folder} has other things in it; choose an empty folder, or one of an earlier page.")


def write_report(dataset_path: str | Path, *, wall_time: float | None = None) -> Path:
    """Write `report.html` into a dataset's folder and return its path; damaged episodes are listed as such.

    Args:
        dataset_path: The folder of the dataset.
        wall_time: How long the collection took [s], for its speed; None leaves that out.

    Raises:
        DatasetError: There is no dataset, or the page cannot be written.
        CorruptEpisode: `dataset.json` is damaged.
    """
    dataset = Dataset.open(dataset_path)
    path = dataset.path / REPORT_FILE
    start, end = shell(is_alone=True, more=_EPISODES_HERE).split(_EPISODES_HERE)
    with disk_errors("write the report", path), tempfile.TemporaryDirectory(prefix="rcs-report-") as name:
        folder = Path(name)
        for part in (EPISODES, CLIPS):
            (folder / part).mkdir()
        renderer = Renderer(dataset=dataset, folder=folder, options=_CLIPS)
        results = {result.record.id: result for result in renderer.render(_in_detail(dataset))}
        details = (part for result in results.values() if not result.why for part in _episode(folder, result.record))
        facts = catalogue(dataset, _all(dataset, results), wall_time=wall_time)
        write_file(path, more=chain([start.encode()], details, [b"<script>"], facts, [f"</script>\n{end}".encode()]))
    return path


def _all(dataset: Dataset, results: dict[str, Rendered]) -> Iterator[Rendered]:
    for record in dataset:
        yield results.get(record.id) or Rendered(record=record, flaws={}, why=_LEFT_OUT)


def _in_detail(dataset: Dataset) -> list[EpisodeRecord]:
    first = dataset.episodes[:_FIRST_IN_DETAIL]
    failed = [record for record in dataset.episodes[_FIRST_IN_DETAIL:] if record.success is False]
    return [*first, *failed][:_MOST_IN_DETAIL]


def _episode(folder: Path, record: EpisodeRecord) -> Iterator[bytes]:
    """Yield an episode as data that the browser parses on use."""
    body = Html(script_values(episode_file(folder, record)))
    yield (element("script", body, type="application/json", data_episode=record.id) + "\n").encode()
    for number, feature in enumerate(pictures(record.info)):
        data = base64.b64encode((folder / CLIPS / record.id / clip_name(feature)).read_bytes()).decode("ascii")
        address = f"data:video/mp4;base64,{data}"
        yield (element("script", address, type="text/plain", data_clip=f"{number} {record.id}") + "\n").encode()
