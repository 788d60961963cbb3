"""Measure the samples per second of LeRobot's loader on an export: `lerobot_loader.py FOLDER WORKERS`.

A sample is one observation with all cameras, decoded by torchcodec, and 16 actions; a batch has 64, in random order.
Prints one line of JSON: `samples_per_second` over ten seconds, after a warm-up.
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version

from vlagents.policies.torch_stack import import_stack

_, datasets, data = import_stack("lerobot", "lerobot.datasets.lerobot_dataset", "torch.utils.data")
HORIZON, BATCH, SECONDS = 16, 64, 10.0


def main(folder: str, workers: int) -> None:
    """Measure and print."""
    fps = datasets.LeRobotDataset("export", root=folder).fps
    ahead = {"action": [step / fps for step in range(HORIZON)]}
    dataset = datasets.LeRobotDataset("export", root=folder, delta_timestamps=ahead, video_backend="torchcodec")
    loader = data.DataLoader(
        dataset, batch_size=BATCH, shuffle=True, num_workers=workers, persistent_workers=workers > 0
    )
    batches = (batch for _ in iter(int, 1) for batch in loader)
    shapes = {key: list(value.shape) for key, value in next(batches).items() if hasattr(value, "shape")}
    samples, begin = 0, time.perf_counter()
    while (seconds := time.perf_counter() - begin) < SECONDS:
        samples += len(next(batches)["action"])
    reader = f"lerobot {version('lerobot')}, torchcodec {version('torchcodec')}"
    print(json.dumps({"reader": reader, "samples_per_second": samples / seconds, "shapes": shapes}))


main(sys.argv[1], int(sys.argv[2]))
