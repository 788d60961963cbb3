"""Writes a dataset with LeRobot's own writer, for our import: `python write_lerobot.py FOLDER`.

The names are those of openpi's examples; tasks change within an episode, one column has texts, one camera is in the
tables and one in a video. Frame n of episode e has n + 100 e as its numbers and as the brightness of its pictures.
"""

from __future__ import annotations

import sys
from pathlib import Path

import lerobot_reader  # noqa: F401  which makes torchvision importable
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

FRAMES, EPISODES, SIZE = 24, 3, 64

names = ["height", "width", "channel"]
dataset = LeRobotDataset.create(
    repo_id="local/foreign",
    root=Path(sys.argv[1]),
    fps=10,
    robot_type="panda",
    features={
        "image": {"dtype": "image", "shape": (SIZE, SIZE, 3), "names": names},
        "wrist_image": {"dtype": "video", "shape": (SIZE, SIZE, 3), "names": names},
        "state": {"dtype": "float32", "shape": (8,), "names": ["state"]},
        "actions": {"dtype": "float32", "shape": (7,), "names": ["actions"]},
        "action_mask": {"dtype": "bool", "shape": (7,), "names": None},
        "note": {"dtype": "string", "shape": (1,), "names": None},
    },
    use_videos=True,
)
for episode in range(EPISODES):
    for frame in range(FRAMES):
        value = frame + 100 * episode
        values = {
            "image": np.full((SIZE, SIZE, 3), frame * 10, np.uint8),
            "wrist_image": np.full((SIZE, SIZE, 3), frame * 10, np.uint8),
            "state": np.full(8, value, np.float32),
            "actions": np.full(7, -value, np.float32),
            "action_mask": np.arange(7) < 6,
            "note": f"note {frame // 5}",
        }
        task = "open the drawer" if frame < FRAMES // 2 else "close the drawer"
        try:
            dataset.add_frame({**values, "task": task})
        except (TypeError, ValueError):  # 0.3.3 takes the task beside the frame
            dataset.add_frame(values, task=task)
    dataset.save_episode()
if hasattr(dataset, "finalize"):
    dataset.finalize()
print(dataset.meta.total_frames)
