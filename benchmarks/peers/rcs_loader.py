"""Measure the samples per second of our loader on a dataset: `rcs_loader.py FOLDER WORKERS`; see lerobot_loader.py."""

from __future__ import annotations

import sys

from rate import HORIZON, report_samples
from rcs_data import Dataset, Windows
from rcs_data.read.torch import TorchDataset

windows = Windows(Dataset.open(sys.argv[1]), horizon=HORIZON)
report_samples("rcs-data", TorchDataset(windows), workers=int(sys.argv[2]), column="step")
