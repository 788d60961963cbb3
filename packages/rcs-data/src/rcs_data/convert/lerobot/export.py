"""Exports a dataset as a LeRobotDataset, v3.0 or v2.1, for LeRobot's own reader.

LeRobot stores T frames of an episode's T + 1 rows; the last observation is left out, and so are depth images.
`meta/rcs_provenance.jsonl` has each episode's origin, `meta/rcs.json` the original features. LeRobot's reader ignores
both.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rcs_data.convert.labels import row_texts
from rcs_data.convert.lerobot.layout import (
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
from rcs_data.convert.lerobot.stats import ImageHistogram, episode_stats
from rcs_data.convert.lerobot.video import encode_video
from rcs_data.convert.lerobot.writer import EncodedEpisode, V3Writer, V21Writer, write_json, write_json_lines
from rcs_data.convert.observations import export_report
from rcs_data.convert.options import ExportOptions, ExportReport, refuse_unused, selected_episodes
from rcs_data.convert.provenance import episode_provenance
from rcs_data.errors import InvalidSetup
from rcs_data.files.output import new_output
from rcs_data.read.reader import Dataset, EpisodeRecord
from rcs_data.read.trajectory import camera_features

Version = Literal["3.0", "2.1"]


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
        temporary = root / "encoding"
        temporary.mkdir(parents=True)
        encode = partial(_encoded, temporary, layout, tasks, subtasks)
        writer = (V3Writer if version == "3.0" else V21Writer)(root, layout, robot, [*tasks], [*subtasks])
        try:
            given = list(zip(range(len(episodes)), firsts, episodes, strict=False))
            ahead = 4 * options.workers
            with ThreadPoolExecutor(options.workers, thread_name_prefix="encode") as pool:
                for start in range(0, len(given), ahead):
                    for episode in pool.map(encode, given[start : start + ahead]):
                        writer.add(episode)
                        if options.on_progress:
                            options.on_progress(episode.first + episode.table.num_rows, firsts[-1])
            writer.finish()
        except BaseException:
            writer.abort()
            raise
        temporary.rmdir()
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
            "order": [feature.key for feature in dataset.info.features],
        }
        write_json(root / RCS_FILE, about)
    images = firsts[-1] * len(layout.cameras)
    return export_report(Path(out), dataset, options, episodes, images, _notes(dataset, layout))


def _encoded(
    folder: Path,
    layout: LeRobotLayout,
    tasks: dict[str, int],
    subtasks: dict[str, int],
    given: tuple[int, int, EpisodeRecord],
) -> EncodedEpisode:
    """Return an encoded episode, independent of the others, so that several threads can share the work.

    Args:
        folder: Where its videos are, until they are put in place.
        layout: The columns and videos.
        tasks: The number of each instruction.
        subtasks: The number of each subtask.
        given: The number of the episode, that of its first frame, and the episode.
    """
    index, first, episode = given
    words = _texts(episode, layout, TASK)
    texts = {"task_index": np.array([tasks[text] for text in words])}
    if parts := _texts(episode, layout, SUBTASK):
        texts["subtask_index"] = np.array([subtasks[text] for text in parts])
    arrays = layout.arrays(episode, index=index, first=first, texts=texts)
    numbers = {name: values for name, values in arrays.items() if layout.numbers[name][0] != TEXT}
    histograms: dict[str, ImageHistogram] = {}
    videos: dict[str, Path] = {}
    for name, feature in layout.cameras.items():
        videos[name] = folder / f"{index}.{name}.mp4"
        histogram = histograms[name] = ImageHistogram(episode.length - 1)
        frames = _counted(islice(episode.frames(feature.key), episode.length - 1), histogram)
        encode_video(videos[name], frames, feature.shape, layout.fps, layout.codec)
    return EncodedEpisode(
        index=index,
        first=first,
        tasks=list(dict.fromkeys(words)),
        table=layout.table(arrays),
        videos=videos,
        stats=episode_stats(numbers) | {name: histogram.stats() for name, histogram in histograms.items()},
        numbers=numbers,
        histograms=histograms,
    )


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
    if depths := camera_features(dataset.info, "depth"):
        yield f"Depth of {', '.join(depths)} was left out: LeRobot keeps no image without loss; rlds and robomimic do."
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
