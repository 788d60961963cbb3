"""Exports a dataset as a LeRobotDataset, v3.0 or v2.1, for LeRobot's own reader.

LeRobot stores T frames of an episode's T + 1 rows. The last observation goes to `rcs/last_rows.parquet`, so that an
import restores every row. Depth images stay lossless, as a video per episode in `rcs/depth`; `meta/calibration.json`
has the camera matrices, `meta/rcs_provenance.jsonl` each episode's origin, `meta/rcs.json` the original features.
LeRobot's reader ignores all of them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from rcs_data.convert.calibration import (
    CALIBRATION_FILE,
    CONVENTION,
    calibration_features,
    write_episode_calibration,
)
from rcs_data.convert.gr00t import MODALITY_FILE, modality
from rcs_data.convert.lerobot_files import EncodedEpisode, write_json, write_json_lines
from rcs_data.convert.lerobot_layout import (
    LAST_ROWS_FILE,
    PROVENANCE_FILE,
    RCS_FILE,
    SUCCESS,
    LeRobotLayout,
    lerobot_layout,
)
from rcs_data.convert.lerobot_stats import ImageHistogram, Moments, quantiles
from rcs_data.convert.lerobot_v3 import V3Writer
from rcs_data.convert.lerobot_v21 import V21Writer
from rcs_data.convert.options import ExportOptions, ExportReport, selected_episodes
from rcs_data.convert.provenance import episode_provenance
from rcs_data.convert.video import encode_depth_video, encode_video
from rcs_data.errors import InvalidSetup
from rcs_data.feature import Feature
from rcs_data.output import new_output, size_on_disk
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
    if version not in ("3.0", "2.1") or (gr00t and version != "2.1"):
        raise InvalidSetup(f"LeRobot v{version} cannot be written{' for GR00T, which reads 2.1' * gr00t}.")
    episodes = selected_episodes(dataset, options)
    layout = lerobot_layout(dataset.info, episodes, options)
    tasks = list(dict.fromkeys(episode.instruction for episode in episodes))
    steps = [episode.length - 1 for episode in episodes]
    firsts = [0, *np.cumsum(steps).tolist()]
    robot = options.robot_type or str(dataset.info.setup.get("robot") or "unknown")
    with new_output(out) as root:
        root.mkdir()
        job = _Job(root=root, layout=layout, tasks=tasks)
        writer = (V3Writer if version == "3.0" else V21Writer)(root, layout, robot, tasks)
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
            write_json(root / MODALITY_FILE, modality(layout))
        _write_beside(root, dataset, episodes, job, robot)
    return ExportReport(
        path=Path(out),
        episodes=len(episodes),
        steps=firsts[-1],
        frames=firsts[-1] * (len(layout.cameras) + len(layout.depths)),
        bytes_written=size_on_disk(Path(out)),
        notes=tuple(_notes(dataset, layout)),
    )


_TEMPORARY = "encoding"


@dataclass(frozen=True, kw_only=True)
class _Job:
    """Encodes episodes independently, so that several threads can share the work."""

    root: Path
    layout: LeRobotLayout
    tasks: list[str]

    def encode(self, given: tuple[int, int, EpisodeRecord]) -> EncodedEpisode:
        """Return an episode with its videos in the temporary folder.

        Args:
            given: Its number, the number of its first frame, and the episode.
        """
        index, first, episode = given
        task = self.tasks.index(episode.instruction)
        arrays = self.layout.arrays(episode, index=index, first=first, task=task)
        moments = {name: Moments.of(values) for name, values in arrays.items()}
        stats = {name: found.stats(quantiles(arrays[name])) for name, found in moments.items()}
        histograms = {name: ImageHistogram(episode.length - 1) for name in self.layout.cameras}
        folder = self.root / _TEMPORARY
        folder.mkdir(exist_ok=True)
        videos: dict[str, Path] = {}
        for name, feature in self.layout.cameras.items():
            videos[name] = folder / f"{index}.{name}.mp4"
            frames = _counted(step_frames(episode, feature.key), histograms[name])
            encode_video(videos[name], frames, feature.shape, self.layout.fps, self.layout.codec)
        for camera, feature in self.layout.depths.items():
            path = self.root / depth_path(camera, index)
            path.parent.mkdir(parents=True, exist_ok=True)
            encode_depth_video(path, step_frames(episode, feature.key), feature.shape, self.layout.fps)
        return EncodedEpisode(
            index=index,
            first=first,
            instruction=episode.instruction,
            table=self.layout.table(arrays),
            videos=videos,
            stats={
                **{name: values for name, values in stats.items() if values is not None},
                **{name: histogram.stats() for name, histogram in histograms.items()},
            },
            moments=moments,
            histograms=histograms,
        )

    def kept(self) -> list[Feature]:
        """Return the exported features, each once."""
        features = [f for column in self.layout.columns for f in column.parts.features]
        features += [*self.layout.cameras.values(), *self.layout.depths.values()]
        return list({feature.key: feature for feature in features}.values())


def depth_path(camera: str, index: int) -> str:
    """Return the path of the depth images of a camera and an episode."""
    return f"rcs/depth/{camera.replace('/', '.')}/chunk-{index // 1000:03d}/episode_{index:06d}.mkv"


def _write_beside(root: Path, dataset: Dataset, episodes: Sequence[EpisodeRecord], job: _Job, robot: str) -> None:
    info, layout = dataset.info, job.layout
    digest = dataset.digest()
    cameras = [*dict.fromkeys([*(_camera(f) for f in layout.cameras.values()), *layout.depths])]
    matrices = calibration_features(info, cameras)
    if matrices:
        entries = [write_episode_calibration(root, episode, i, matrices) for i, episode in enumerate(episodes)]
        write_json(root / CALIBRATION_FILE, {"convention": CONVENTION, "episodes": entries})
    _write_last_rows(root / LAST_ROWS_FILE, episodes, job.kept() + [f for m in matrices.values() for f in m.values()])
    write_json_lines(
        root / PROVENANCE_FILE,
        ({"episode_index": i, **episode_provenance(episode, digest)} for i, episode in enumerate(episodes)),
    )
    about = {
        "schema_version": 1,
        "dataset": digest,
        "frequency": info.frequency,
        "instruction": info.instruction,
        "robot_type": robot,
        "setup": info.setup,
        "columns": [column.to_json() for column in layout.columns],
        "cameras": {name: feature.to_json() for name, feature in layout.cameras.items()},
        "depths": {name: feature.to_json() for name, feature in layout.depths.items()},
        "calibration": {c: {name: f.to_json() for name, f in m.items()} for c, m in matrices.items()},
        "order": [feature.key for feature in info.features],
    }
    write_json(root / RCS_FILE, about)


def _write_last_rows(path: Path, episodes: Sequence[EpisodeRecord], features: Sequence[Feature]) -> None:
    """Write the last observation of each episode, images as the dataset stores them."""
    seen = [f for f in features if not f.is_unknown_at_reset and f.key not in ("terminated", "truncated")]
    path.parent.mkdir(parents=True, exist_ok=True)
    fields = [pa.field("episode_index", pa.int64()), *(pa.field(f.key, f.arrow_type) for f in seen)]
    with pq.ParquetWriter(path, pa.schema(fields), compression="zstd") as writer:
        for index, episode in enumerate(episodes):
            arrays = [pa.array([index], pa.int64()), *(_last(episode, feature) for feature in seen)]
            writer.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)))


def _last(episode: EpisodeRecord, feature: Feature) -> pa.Array:
    if feature.is_image:
        return pa.array(list(deque(episode.encoded_frames(feature.key), maxlen=1)), pa.binary())
    value: NDArray[Any] = episode.column(feature.key)[-1:]
    flat = pa.array(np.ascontiguousarray(value).reshape(-1))
    return flat if feature.shape == () else pa.FixedSizeListArray.from_arrays(flat, feature.size)


def _notes(dataset: Dataset, layout: LeRobotLayout) -> Iterator[str]:
    if not layout.has_success:
        yield f"Not every episode has a verdict, so there is no column {SUCCESS}."
    if layout.depths:
        yield "LeRobot has no place for lossless depth; it is in rcs/depth, a video per episode (FFV1, 16 bits, mm)."
    if layout.fps != dataset.info.frequency:
        yield f"The export claims {layout.fps} frames/s; the dataset was recorded at {dataset.info.frequency:g}."
    used = {f.key for column in layout.columns for f in column.parts.features}
    left = [f.key for f in dataset.info.features if not f.is_image and "/frames/" not in f.key and f.key not in used]
    if left:
        yield f"Not exported: {', '.join(left)}; add with --extra."


def _camera(feature: Feature) -> str:
    return "/".join(feature.key.split("/")[2:-1])


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
