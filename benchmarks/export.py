"""Compare the images per second of an export to LeRobot v3.0 with bare encoding of the same images, in the same run.

Collects episodes of PickCuboid with two cameras of 224 x 224 pixels and exports them. The reference is PyAV with the
same codec and settings, given images that are decoded already, an episode at a time: what no export could be faster
than. Then every video is decoded again and compared.

Prints one JSON object: `frames_per_second_per_core` (images of both cameras by processor time, all threads counted),
`frames_per_second` (by the clock), `reference_frames_per_second_per_core`, `bytes_per_frame` (videos alone), `psnr_db`,
`colour_error` (the mean error of a channel, of 255) and `codec`.
"""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import tyro
from loader import collected
from rcs_data import Dataset
from rcs_data.convert.lerobot.export import export_lerobot
from rcs_data.convert.lerobot.layout import IMAGES
from rcs_data.convert.lerobot.video import VideoReader, encode_video
from rcs_data.convert.options import ExportOptions, VideoCodec
from rcs_data.read.trajectory import camera_features

# Bare encoding takes a sample of episodes: it does not depend on their number.
SAMPLE = 20


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    episodes: int = 40
    """Episodes to collect and export."""
    codec: VideoCodec = "h264"
    """Video codec."""
    workers: int = 1
    """Threads that encode."""
    dataset: Path | None = None
    """A dataset to use instead."""


def main(options: Options) -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder:
        source = options.dataset or collected(Path(folder) / "dataset", options.episodes, workers=2)
        dataset = Dataset.open(source)
        out = Path(folder) / "export"
        start, used = time.perf_counter(), time.process_time()
        report = export_lerobot(dataset, out, ExportOptions(codec=options.codec, workers=options.workers))
        seconds, used = time.perf_counter() - start, time.process_time() - used
        videos = sum(path.stat().st_size for path in out.rglob("*.mp4"))
        result: dict[str, Any] = {
            "benchmark": "export",
            "frames_per_second_per_core": round(report.frames / used),
            "frames_per_second": round(report.frames / seconds),
            "reference_frames_per_second_per_core": round(reference(dataset, Path(folder), options)),
            "episodes": report.episodes,
            "frames": report.frames,
            "bytes_per_frame": round(videos / report.frames),
            "bytes": report.bytes_written,
            **errors(dataset, out),
            "codec": options.codec,
            "workers": options.workers,
        }
    print(json.dumps(result))


def reference(dataset: Dataset, folder: Path, options: Options) -> float:
    """Return images per second and core of encoding alone."""
    frames, used = 0, 0.0
    for episode in dataset.episodes[:SAMPLE]:
        for feature in camera_features(dataset.info).values():
            images = list(episode.frames(feature.key))[:-1]
            start = time.process_time()
            frames += encode_video(
                folder / "reference.mp4", images, feature.shape, round(dataset.info.frequency), options.codec
            )
            used += time.process_time() - start
    return frames / used


def errors(dataset: Dataset, out: Path) -> dict[str, float]:
    """Return how far the images of the first episodes are from what was exported, as our own import reads them."""
    about = pq.read_table(out / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pylist()
    squares, colours = [], []
    for camera, feature in camera_features(dataset.info).items():
        path = out / "videos" / f"{IMAGES}{camera}" / "chunk-000" / "file-000.mp4"
        reader = VideoReader(path)
        for row, episode in zip(about[:SAMPLE], dataset.episodes, strict=False):
            start = row[f"videos/{IMAGES}{camera}/from_timestamp"]
            frames = reader.frames(start, row["length"], dataset.info.frequency)
            for image, truth in zip(frames, list(episode.frames(feature.key))[:-1], strict=True):
                error = image.astype(np.float64) - truth
                squares.append(float(np.mean(error**2)))
                colours.append(error.mean(axis=(0, 1)))
        reader.close()
    psnr = 10 * np.log10(255**2 / np.mean(squares))
    return {"psnr_db": round(float(psnr), 1), "colour_error": round(float(np.abs(np.mean(colours, axis=0)).max()), 2)}


if __name__ == "__main__":
    main(tyro.cli(Options))
