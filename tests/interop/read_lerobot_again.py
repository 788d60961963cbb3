"""Reads with LeRobot what `import_lerobot.py` exported: `python read_lerobot_again.py EXPORT`."""

from __future__ import annotations

import sys
from pathlib import Path

import lerobot_reader
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.lerobot_dataset import LeRobotDataset

FRAMES, EPISODES = 24, 3

lerobot_dataset.decode_video_frames = lerobot_reader.decode_frames
dataset = LeRobotDataset("local/again", root=Path(sys.argv[1]), video_backend="pyav")
assert len(dataset) == FRAMES * EPISODES, len(dataset)
for row in range(len(dataset)):
    item, (episode, frame) = dataset[row], divmod(row, FRAMES)
    assert item["task"] == ("open the drawer" if frame < FRAMES // 2 else "close the drawer"), item["task"]
    assert item["note"] == f"note {frame // 5}", item["note"]
    assert item["action_mask"].tolist() == [True] * 6 + [False]
    assert item["observation.state"][0] == frame + 100 * episode
    assert item["action"][0] == -(frame + 100 * episode)
    for camera in ("image", "wrist_image"):
        assert abs(item[f"observation.images.{camera}"].mean() * 255 - 10 * frame) < 4
print(f"{sys.argv[1]}: all {len(dataset)} frames, tasks and texts")
