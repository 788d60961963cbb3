"""Measure the samples per second of LeRobot's loader on an export: `lerobot_loader.py FOLDER WORKERS`.

A sample is one observation with all cameras, decoded by torchcodec, and 16 actions; a batch has 64, in random order.
Prints one line of JSON: `samples_per_second` over ten seconds, after a warm-up.
"""

from __future__ import annotations

import sys
from importlib.metadata import version

from rate import HORIZON, report_samples
from vlagents.policies.stack import import_stack

_, datasets = import_stack("lerobot", "torch", "lerobot.datasets.lerobot_dataset")
fps = datasets.LeRobotDataset("export", root=sys.argv[1]).fps
ahead = {"action": [step / fps for step in range(HORIZON)]}
dataset = datasets.LeRobotDataset("export", root=sys.argv[1], delta_timestamps=ahead, video_backend="torchcodec")
reader = f"lerobot {version('lerobot')}, torchcodec {version('torchcodec')}"
report_samples(reader, dataset, workers=int(sys.argv[2]), column="action")
