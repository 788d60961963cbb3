"""Imports what `write_lerobot.py` wrote and compares it: `python import_lerobot.py FOLDER`, with our interpreter.

Then it exports the import, which `read_lerobot_again.py` reads with LeRobot.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
from rcs_data import Windows, check
from rcs_data.convert.labels import row_texts
from rcs_data.convert.lerobot.export import export_lerobot
from rcs_data.convert.lerobot.import_ import import_lerobot
from rcs_data.convert.options import ExportOptions
from rcs_data.read.trajectory import action_layout, camera_features, state_layout

FRAMES = 24

root = Path(sys.argv[1])
version = "2.1" if "v2" in (root / "meta" / "info.json").read_text() else "3.0"
back, again = (root.with_name(f"{root.name}-{what}") for what in ("imported", "again"))
for path in (back, again):
    shutil.rmtree(path, ignore_errors=True)
dataset = import_lerobot(root, back)
assert check(back).is_ok, check(back).findings
assert [f.key for f in state_layout(dataset.info).features] == ["observation/state"]
assert [f.key for f in action_layout(dataset.info).features] == ["action/action"]
assert list(camera_features(dataset.info)) == ["image", "wrist_image"]
assert len(dataset) == 3
for number, episode in enumerate(dataset.episodes):
    value = np.arange(FRAMES, dtype=np.float32) + 100 * number
    np.testing.assert_array_equal(episode.column("observation/state")[:-1], np.repeat(value[:, None], 8, axis=1))
    np.testing.assert_array_equal(episode.column("action/action")[1:], -np.repeat(value[:, None], 7, axis=1))
    np.testing.assert_array_equal(episode.column("extra/action_mask")[0], np.arange(7) < 6)
    for camera in ("image", "wrist_image"):
        shades = episode.column(f"observation/frames/{camera}/rgb")[:-1].mean(axis=(1, 2, 3))
        assert np.abs(shades - 10 * np.arange(FRAMES)).max() < 4, shades
    half = FRAMES // 2
    tasks = ["open the drawer"] * half + ["close the drawer"] * (half + 1)
    assert row_texts(episode, "extra/task_index") == tasks
    notes = [f"note {n // 5}" for n in range(FRAMES)]
    assert row_texts(episode, "extra/note") == [*notes, notes[-1]]
assert Windows(dataset, horizon=4)[0]["actions"].shape == (4, 7)
export_lerobot(dataset, again, ExportOptions(extra=("extra/note", "extra/action_mask")), version=version)
print(f"{root}: {version} imported, exported again to {again}")
