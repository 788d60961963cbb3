"""The page: a folder with an `index.html` that opens from the disk, without a server and without a network."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from rcs_data.durable import disk_errors
from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.output import OnProgress, size_on_disk
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.view.catalogue import write_catalogue
from rcs_data.view.clips import ClipOptions
from rcs_data.view.html import Html, element, page, script, style, web
from rcs_data.view.rendering import CLIPS, EPISODES, Rendered, Renderer, put, sweep

VIEW_FOLDER = "view"
"""The page's folder in that of the dataset, where no other is given."""

_CATALOGUE = "dataset.js"
_STYLE = "viewer.css"
_SCRIPTS = ("plots.js", "player.js", "catalogue.js", "viewer.js")


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
    on_progress: OnProgress | None = None,
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
    chosen = chosen_episodes(dataset, episodes)
    counts = {"rendered": 0, "kept": 0, "damaged": 0}

    def counted() -> Iterator[Rendered]:
        renderer = Renderer(dataset=dataset, folder=folder, options=options or ClipOptions())
        for number, result in enumerate(renderer.render(chosen)):
            counts["rendered"] += result.is_new
            counts["kept"] += not (result.is_new or result.why)
            counts["damaged"] += result.is_damaged
            if on_progress is not None:
                on_progress(number + 1, len(chosen))
            yield result

    with disk_errors("write the page", folder):
        _require_own(folder)
        for name in (EPISODES, CLIPS):
            (folder / name).mkdir(parents=True, exist_ok=True)
        # Until all episodes are there, so that a page that was not completed is known as one.
        put(folder / _CATALOGUE, b"rcsDataset(null);\n")
        put(folder / "index.html", shell(is_alone=False).encode())
        for name in (_STYLE, *_SCRIPTS):
            put(folder / name, web(name).encode())
        sweep(folder, chosen)
        partial = folder / f".{_CATALOGUE}.tmp"
        partial.unlink(missing_ok=True)  # never through a link
        with partial.open("x", encoding="ascii") as file:
            write_catalogue(file, dataset, counted())
        partial.replace(folder / _CATALOGUE)
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
    if folder.exists() and any(folder.iterdir()) and not (folder / _CATALOGUE).exists():
        raise DatasetError(f"{folder} has other things in it; choose an empty folder, or one of an earlier page.")
