"""Measure the samples per second of our loader on a dataset: `rcs_loader.py FOLDER WORKERS`; see lerobot_loader.py."""

from __future__ import annotations

import json
import sys
import time

from rcs_data import Dataset, Windows
from rcs_data.read.torch import TorchDataset
from torch.utils.data import DataLoader

HORIZON, BATCH, SECONDS = 16, 64, 10.0


def main(folder: str, workers: int) -> None:
    """Measure and print."""
    dataset = TorchDataset(Windows(Dataset.open(folder), horizon=HORIZON))
    loader = DataLoader(dataset, batch_size=BATCH, shuffle=True, num_workers=workers, persistent_workers=workers > 0)
    batches = (batch for _ in iter(int, 1) for batch in loader)
    next(batches)
    samples, begin = 0, time.perf_counter()
    while (seconds := time.perf_counter() - begin) < SECONDS:
        samples += len(next(batches)["step"])
    print(json.dumps({"reader": "rcs-data", "samples_per_second": samples / seconds}))


main(sys.argv[1], int(sys.argv[2]))
