"""Records, checks, edits and reads a long episode with little memory: python large_episode.py MEGABYTES FOLDER."""

from __future__ import annotations

import resource
import sys
from pathlib import Path

import numpy as np
import simplejpeg
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, FrameAccess, check, edit

KEY = "observation/frames/wrist/rgb"
SHAPE = (480, 640, 3)
FREE = 200 << 20
"""Memory beside what the libraries take [B]."""


def main(megabytes: int, path: Path) -> None:
    """Do all of it."""
    joints = Feature(key="observation/joints", shape=(7,), dtype="float64")
    camera = Feature(key=KEY, shape=SHAPE, dtype="uint8", encoding="jpeg")
    time = Feature(key="time/monotonic", shape=(), dtype="float64", unit="s")
    info = DatasetInfo(frequency=30.0, setup={}, instruction="", features=(joints, time, camera))
    rng = np.random.default_rng(0)
    images = [simplejpeg.encode_jpeg(rng.integers(0, 256, SHAPE, np.uint8), 95) for _ in range(3)]
    rows = megabytes * 1_000_000 // len(images[0]) + 1
    # Of the data segment, not of all addresses: files are mapped.
    used = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmData"))
    limit = int(used.split()[1]) * 1024 + FREE
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    with DatasetWriter.open(path, info) as writer, writer.episode("a", seed=0) as recording:
        for row in range(rows):
            recording.add({joints.key: np.full(7, 0.001 * row), time.key: row / 30, KEY: images[row % 3]})
        recording.finish(True)
    edit.rename_camera(path, "wrist", "side")
    edit.rename_camera(path, "side", "wrist")
    episode = Dataset.open(path)["a"]
    assert (episode.path / "frames.zip").stat().st_size > 990_000 * megabytes
    assert check(path, workers=1, depth="frames" if megabytes < 1000 else "rows").is_ok
    assert [images.index(image) for image in episode.encoded_frames(KEY)] == [row % 3 for row in range(rows)]
    assert sum(piece.num_rows for piece in episode.rows()) == rows
    assert FrameAccess().frame(episode, KEY, rows - 1).shape == SHAPE


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
