"""The report: the page of a dataset as one file beside it, which can be passed on by itself."""

from __future__ import annotations

import base64
import html
import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

from rcs_data.durable import disk_errors
from rcs_data.errors import CorruptEpisode
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.view.catalogue import catalogue
from rcs_data.view.clips import ClipOptions, pictures
from rcs_data.view.page import EPISODE_FILE, WEB, clip_name, render, script

REPORT_FILE = "report.html"

# Smaller than those of the page in a folder: about 60 kB for a camera and four seconds.
_CLIPS = ClipOptions(height=224, quality=30, whole_frame_every=30)
# So many of the first episodes, and of all episodes that failed, are in the page with clips and curves.
_FIRST_IN_DETAIL = 60
_MOST_IN_DETAIL = 120
_LEFT_OUT = "was left out, but for its outcome, to keep this file small; `rcs data view` shows all episodes."


def write_report(dataset_path: str | Path, *, wall_time: float | None = None, scripted: float | None = None) -> Path:
    """Write `report.html` into a dataset's folder and return its path; damaged episodes are listed as such.

    Args:
        dataset_path: The folder of the dataset.
        wall_time: How long the collection took [s], for its speed; None leaves that out.
        scripted: By how much the ways of the task's scripted expert differ [rad]; None leaves that out.

    Raises:
        DatasetError: There is no dataset, or the page cannot be written.
        CorruptEpisode: `dataset.json` is damaged.
    """
    dataset = Dataset.open(dataset_path)
    path = dataset.path / REPORT_FILE
    detailed = _in_detail(dataset)
    partial = path.with_name(f".{REPORT_FILE}.tmp")
    with disk_errors("write the report", path), tempfile.TemporaryDirectory(prefix="rcs-report-") as name:
        folder = Path(name)
        results = {result.record.id: result for result in render(detailed, folder, _CLIPS)}
        entries = [
            (results[record.id].record, results[record.id].flaws, results[record.id].why)
            if record.id in results
            else (record, {}, _LEFT_OUT)
            for record in dataset
        ]
        clips = [clip_name(feature) for feature in pictures(dataset.info)]
        values = catalogue(dataset, entries, clips, wall_time=wall_time, scripted=scripted)
        shell, tail = _shell().split("</body>")
        partial.unlink(missing_ok=True)  # never through a link
        with partial.open("x", encoding="utf-8") as page:
            page.write(shell.replace('<script src="dataset.js"></script>', ""))
            for record in detailed:
                if not results[record.id].why:
                    _write_episode(page.write, folder / record.id, record.id, clips)
            page.write(f"<script>{_inert(script('rcsDataset', values).decode('ascii'))}</script>\n</body>{tail}")
            page.flush()
            os.fsync(page.fileno())
        partial.replace(path)
    return path


def _in_detail(dataset: Dataset) -> list[EpisodeRecord]:
    first = dataset.episodes[:_FIRST_IN_DETAIL]
    failed = [record for record in dataset.episodes[_FIRST_IN_DETAIL:] if _has_failed(record)]
    return [*first, *failed][:_MOST_IN_DETAIL]


def _has_failed(record: EpisodeRecord) -> bool:
    try:
        return record.success is False
    except CorruptEpisode:
        return False


def _shell() -> str:
    """Return the page with its style and scripts in it."""
    text = (WEB / "index.html").read_text("utf-8")
    text = re.sub(r'<link rel="stylesheet" href="([\w.]+)">', lambda m: f"<style>\n{_web(m[1])}</style>", text)
    return re.sub(r'<script src="(?!dataset)([\w.]+)"></script>', lambda m: f"<script>\n{_web(m[1])}</script>", text)


def _web(name: str) -> str:
    return (WEB / name).read_text("utf-8")


def _inert(text: str) -> str:
    """Escape what could end a script's tag; inside of JSON's strings, where it stands only, this is the same text."""
    return text.replace("<", "\\u003c")


def _write_episode(write: Callable[[str], object], folder: Path, episode_id: str, clips: list[str]) -> None:
    """Write an episode as data that the browser does not look at before it is asked for."""
    lines = (folder / EPISODE_FILE).read_text("ascii").split("\n", 1)[1]
    body = lines.strip().removeprefix("rcsEpisode(").removesuffix(");")
    write(f'<script type="application/json" data-episode="{html.escape(episode_id)}">{_inert(body)}</script>\n')
    for number, name in enumerate(clips):
        write(f'<script type="text/plain" data-clip="{number} {html.escape(episode_id)}">data:video/mp4;base64,')
        write(base64.b64encode((folder / name).read_bytes()).decode("ascii"))
        write("</script>\n")
