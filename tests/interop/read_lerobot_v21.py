"""Opens an export with LeRobot 0.3.3: every frame, windows and statistics; and what GR00T reads beside it, if there.

Run with the interpreter that has it: `python read_lerobot_v21.py EXPORT EXPECTED`. Prints one line of JSON.
"""

from __future__ import annotations

import json

import lerobot_reader
import numpy as np
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.lerobot_dataset import LeRobotDataset

lerobot_dataset.decode_video_frames = lerobot_reader.decode_frames


def main() -> None:
    """Compare."""
    root, expected = lerobot_reader.arguments()
    dataset = LeRobotDataset("local/rcs", root=root, video_backend="pyav")
    found = lerobot_reader.compare(dataset, expected)

    windows = LeRobotDataset(
        "local/rcs", root=root, video_backend="pyav", delta_timestamps={"action": [i / dataset.fps for i in range(8)]}
    )
    assert windows[3]["action"].shape[0] == 8, windows[3]["action"].shape

    modality_file = root / "meta" / "modality.json"
    if modality_file.exists():
        modality = json.loads(modality_file.read_text())
        for kind, name in (("state", "observation.state"), ("action", "action")):
            places = [range(part["start"], part["end"]) for part in modality[kind].values()]
            covered = np.concatenate([np.array(place) for place in places])
            np.testing.assert_array_equal(covered, np.arange(dataset.meta.features[name]["shape"][0]))
        assert all(video["original_key"] in dataset.meta.video_keys for video in modality["video"].values())
        found["modality"] = list(modality["state"])
    print(json.dumps({"reader": "lerobot 0.3.3", "export": root.name, **found}))


if __name__ == "__main__":
    main()
