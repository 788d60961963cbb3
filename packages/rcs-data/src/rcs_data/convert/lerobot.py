"""Exports a dataset as a LeRobotDataset, v3.0 or v2.1, for LeRobot's own reader.

LeRobot stores T frames of an episode's T + 1 rows; the last observation is left out. Depth images stay lossless, as a
video per episode in `rcs/depth`; `meta/rcs_provenance.jsonl` has each episode's origin, `meta/rcs.json` the original
features. LeRobot's reader ignores all three.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from rcs_data.convert.labels import row_texts
from rcs_data.convert.lerobot_layout import (
    IMAGES,
    PROVENANCE_FILE,
    RCS_FILE,
    SUBTASK,
    SUCCESS,
    TASK,
    TEXT,
    LeRobotLayout,
    lerobot_layout,
)
from rcs_data.convert.lerobot_stats import ImageHistogram, episode_stats
from rcs_data.convert.lerobot_writer import EncodedEpisode, V3Writer, V21Writer, write_json, write_json_lines
from rcs_data.convert.observations import export_report
from rcs_data.convert.options import ExportOptions, ExportReport, refuse_unused, selected_episodes
from rcs_data.convert.provenance import episode_provenance
from rcs_data.convert.video import copy_video, encode_depth_video, encode_video
from rcs_data.errors import InvalidSetup
from rcs_data.feature import Feature
from rcs_data.output import new_output
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.trajectory import step_frames

Version = Literal["3.0", "2.1"]

_Given = TypeVar("_Given")
_Made = TypeVar("_Made")


def export_lerobot(
    dataset: Dataset,
    out: str | Path,
    options: ExportOptions | None = None,
    *,
    version: Version = "3.0",
    gr00t: bool = False,
) -> ExportReport:
    """Write a dataset as a LeRobotDataset, whole or not at all.

    Args:
        dataset: The dataset.
        out: The folder to make.
        options: Episodes and features to export, and compression of videos.
        version: The layout: "3.0" for lerobot 0.4 and newer, "2.1" for openpi, lerobot 0.3 and GR00T.
        gr00t: Whether to add `meta/modality.json`, which GR00T needs beside v2.1.

    Raises:
        InvalidSetup: An option does not suit the dataset or the format.
        DatasetError: `out` exists, a video was encoded wrongly, or the disk fails.
        CorruptEpisode: An episode is damaged.
    """
    options = options or ExportOptions()
    refuse_unused(options, "LeRobot", ("state", "action", "extra", "robot_type", "fps", "codec"))
    if version not in ("3.0", "2.1") or (gr00t and version != "2.1"):
        raise InvalidSetup(f"LeRobot v{version} cannot be written{' for GR00T, which reads 2.1' * gr00t}.")
    episodes = selected_episodes(dataset, options)
    layout = lerobot_layout(dataset.info, episodes, options)
    tasks, subtasks = (_numbered(episodes, layout, key) for key in (TASK, SUBTASK))
    firsts = [0, *np.cumsum([episode.length - 1 for episode in episodes]).tolist()]
    robot = options.robot_type or str(dataset.info.setup.get("robot") or "unknown")
    digest = dataset.digest()
    with new_output(out) as root:
        root.mkdir()
        job = _Job(root=root, layout=layout, tasks=tasks, subtasks=subtasks)
        writer = (V3Writer if version == "3.0" else V21Writer)(root, layout, robot, [*tasks], [*subtasks])
        try:
            given = list(zip(range(len(episodes)), firsts, episodes, strict=False))
            for episode in _in_order(job.encode, given, options.workers):
                writer.add(episode)
                if options.on_progress:
                    options.on_progress(episode.first + episode.table.num_rows, firsts[-1])
            writer.finish()
        except BaseException:
            writer.abort()
            raise
        (root / _TEMPORARY).rmdir()
        if gr00t:
            write_json(root / "meta" / "modality.json", _modality(layout))
        rows = ({"episode_index": i, **episode_provenance(episode, digest)} for i, episode in enumerate(episodes))
        write_json_lines(root / PROVENANCE_FILE, rows)
        about = {
            "schema_version": 1,
            "dataset": digest,
            "frequency": dataset.info.frequency,
            "instruction": dataset.info.instruction,
            "robot_type": robot,
            "setup": dataset.info.setup,
            "columns": [column.to_json() for column in layout.columns],
            "cameras": {name: feature.to_json() for name, feature in layout.cameras.items()},
            "depths": {name: feature.to_json() for name, feature in layout.depths.items()},
            "order": [feature.key for feature in dataset.info.features],
        }
        write_json(root / RCS_FILE, about)
    images = firsts[-1] * (len(layout.cameras) + len(layout.depths))
    return export_report(Path(out), dataset, options, episodes, images, _notes(dataset, layout))


_TEMPORARY = "encoding"


@dataclass(frozen=True, kw_only=True)
class _Job:
    """Encodes episodes independently, so that several threads can share the work."""

    root: Path
    layout: LeRobotLayout
    tasks: dict[str, int]
    """The number of each instruction."""
    subtasks: dict[str, int]
    """The number of each subtask."""

    def encode(self, given: tuple[int, int, EpisodeRecord]) -> EncodedEpisode:
        """Return an episode, given its number, its first frame's and itself; its videos are in the temporary folder."""
        index, first, episode = given
        tasks = _texts(episode, self.layout, TASK)
        texts = {"task_index": np.array([self.tasks[text] for text in tasks])}
        if subtasks := _texts(episode, self.layout, SUBTASK):
            texts["subtask_index"] = np.array([self.subtasks[text] for text in subtasks])
        arrays = self.layout.arrays(episode, index=index, first=first, texts=texts)
        numbers = {name: values for name, values in arrays.items() if self.layout.numbers[name][0] != TEXT}
        histograms: dict[str, ImageHistogram] = {}
        folder = self.root / _TEMPORARY
        folder.mkdir(exist_ok=True)
        videos: dict[str, Path] = {}
        for name, feature in self.layout.cameras.items():
            videos[name] = folder / f"{index}.{name}.mp4"
            histograms[name] = self._film(episode, feature, videos[name])
        for camera, feature in self.layout.depths.items():
            path = self.root / depth_path(camera, index)
            path.parent.mkdir(parents=True, exist_ok=True)
            encode_depth_video(path, step_frames(episode, feature.key), feature.shape, self.layout.fps)
        return EncodedEpisode(
            index=index,
            first=first,
            tasks=list(dict.fromkeys(tasks)),
            table=self.layout.table(arrays),
            videos=videos,
            stats=episode_stats(numbers) | {name: histogram.stats() for name, histogram in histograms.items()},
            numbers=numbers,
            histograms=histograms,
        )

    def _film(self, episode: EpisodeRecord, feature: Feature, path: Path) -> ImageHistogram:
        """Write the video of a camera, as it is stored where that can be, and return the histogram of its images."""
        form = feature.shape, self.layout.fps, self.layout.codec
        if feature.video == self.layout.codec:
            histogram = ImageHistogram(episode.length - 1)
            images = _counted(step_frames(episode, feature.key), histogram)
            if copy_video(path, _packets(episode, feature.key), images, *form):
                return histogram
        histogram = ImageHistogram(episode.length - 1)
        encode_video(path, _counted(step_frames(episode, feature.key), histogram), *form)
        return histogram


def _packets(episode: EpisodeRecord, key: str) -> Iterator[bytes]:
    """Yield the image of each step as it is stored; nothing for one that repeats the one before it."""
    for rows in episode.rows(stop=episode.length - 1, packets=True):
        for image in rows.column(key):
            yield image.as_py() or b""


def _numbered(episodes: Iterable[EpisodeRecord], layout: LeRobotLayout, key: str) -> dict[str, int]:
    """Return the number of each text, in order of appearance."""
    known: dict[str, int] = {}
    for episode in episodes:
        for text in _texts(episode, layout, key):
            known.setdefault(text, len(known))
    return known


def _texts(episode: EpisodeRecord, layout: LeRobotLayout, key: str) -> list[str]:
    """Return the task or subtask of each step."""
    if key in layout.tables:
        return row_texts(episode, key)[:-1]
    return [episode.instruction] * (episode.length - 1) if key == TASK else []


def depth_path(camera: str, index: int) -> str:
    """Return the path of the depth images of a camera and an episode."""
    return f"rcs/depth/{camera.replace('/', '.')}/chunk-{index // 1000:03d}/episode_{index:06d}.mkv"


def _modality(layout: LeRobotLayout) -> dict[str, Any]:
    """Return what GR00T needs beside v2.1: parts of state and action by name, cameras, and the instruction.

    Layout: the "Robot Data Preparation Guide" of NVIDIA's Isaac-GR00T.
    """
    state, action = (
        {"_".join(key.split("/")[1:]): {"start": at.start, "end": at.stop} for key, at in column.parts.slices.items()}
        for column in layout.columns[:2]
    )
    return {
        "state": state,
        "action": action,
        "video": {name.removeprefix(IMAGES): {"original_key": name} for name in layout.cameras},
        "annotation": {"human.task_description": {"original_key": "task_index"}},
    }


def _notes(dataset: Dataset, layout: LeRobotLayout) -> Iterator[str]:
    if not layout.has_success:
        yield f"Not every episode has a verdict, so there is no column {SUCCESS}."
    if layout.depths:
        yield "LeRobot has no place for lossless depth; it is in rcs/depth, a video per episode (FFV1, 16 bits, mm)."
    if layout.fps != dataset.info.frequency:
        yield f"The export claims {layout.fps} frames/s; the dataset was recorded at {dataset.info.frequency:g}."
    used = {f.key for column in layout.columns for f in column.parts.features} | {*layout.tables}
    left = [f.key for f in dataset.info.features if not f.is_image and "/frames/" not in f.key and f.key not in used]
    if left:
        yield f"Not exported: {', '.join(left)}; add with --extra."


def _counted(frames: Iterable[NDArray[Any]], histogram: ImageHistogram) -> Iterator[NDArray[Any]]:
    for frame in frames:
        histogram.add(frame)
        yield frame


def _in_order(work: Callable[[_Given], _Made], given: Iterable[_Given], workers: int) -> Iterator[_Made]:
    """Yield results in order, while threads work on the next few."""
    pool = ThreadPoolExecutor(workers, thread_name_prefix="encode")
    waiting: deque[Future[_Made]] = deque()
    try:
        for item in given:
            waiting.append(pool.submit(work, item))
            if len(waiting) > workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
