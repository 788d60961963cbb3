"""The report: the page of a dataset as one file beside it, which can be passed on by itself."""

from __future__ import annotations

import base64
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from rcs_data.durable import disk_errors
from rcs_data.errors import CorruptEpisode
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.view.catalogue import write_catalogue
from rcs_data.view.clips import ClipOptions, pictures
from rcs_data.view.html import Html, element
from rcs_data.view.page import shell
from rcs_data.view.rendering import CLIPS, EPISODES, Rendered, Renderer, clip_name, episode_file

REPORT_FILE = "report.html"

# Smaller than those of the page in a folder: about 60 kB for a camera and four seconds.
_CLIPS = ClipOptions(height=224, quality=30, whole_frame_every=30)
# So many of the first episodes, and of all episodes that failed, are in the page with clips and curves.
_FIRST_IN_DETAIL = 60
_MOST_IN_DETAIL = 120
_LEFT_OUT = "was left out, but for its outcome, to keep this file small; `rcs-data view` shows all episodes."
_EPISODES_HERE = Html("<!-- episodes -->")


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
    partial = path.with_name(f".{REPORT_FILE}.tmp")
    start, end = shell(is_alone=True, more=_EPISODES_HERE).split(_EPISODES_HERE)
    with disk_errors("write the report", path), tempfile.TemporaryDirectory(prefix="rcs-report-") as name:
        folder = Path(name)
        for part in (EPISODES, CLIPS):
            (folder / part).mkdir()
        renderer = Renderer(dataset=dataset, folder=folder, options=_CLIPS)
        results = {result.record.id: result for result in renderer.render(_in_detail(dataset))}
        partial.unlink(missing_ok=True)  # never through a link
        with partial.open("x", encoding="utf-8") as file:
            file.write(start)
            for result in results.values():
                if not result.why:
                    _write_episode(file.write, folder, result.record)
            file.write("<script>")
            write_catalogue(file, dataset, _all(dataset, results), wall_time=wall_time, scripted=scripted)
            file.write(f"</script>\n{end}")
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    return path


def _all(dataset: Dataset, results: dict[str, Rendered]) -> Iterator[Rendered]:
    for record in dataset:
        yield results.get(record.id) or Rendered(record=record, flaws={}, why=_LEFT_OUT)


def _in_detail(dataset: Dataset) -> list[EpisodeRecord]:
    first = dataset.episodes[:_FIRST_IN_DETAIL]
    failed = [record for record in dataset.episodes[_FIRST_IN_DETAIL:] if _has_failed(record)]
    return [*first, *failed][:_MOST_IN_DETAIL]


def _has_failed(record: EpisodeRecord) -> bool:
    try:
        return record.success is False
    except CorruptEpisode:
        return False


def _write_episode(write: Callable[[str], object], folder: Path, record: EpisodeRecord) -> None:
    """Write an episode as data that the browser does not look at before it is asked for."""
    values = episode_file(folder, record).read_text("ascii").split("\n", 1)[1]
    body = Html(values.strip().removeprefix("rcsEpisode(").removesuffix(");"))
    write(element("script", body, type="application/json", data_episode=record.id) + "\n")
    for number, feature in enumerate(pictures(record.info)):
        data = base64.b64encode((folder / CLIPS / record.id / clip_name(feature)).read_bytes()).decode("ascii")
        address = f"data:video/mp4;base64,{data}"
        write(element("script", address, type="text/plain", data_clip=f"{number} {record.id}") + "\n")
