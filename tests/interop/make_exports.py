"""Records a few episodes, exports them in every format, and writes down what a reader must find in them.

Run with the project's own interpreter: `python make_exports.py FOLDER [FORMAT ...]`. It makes `FOLDER/source`,
the exports `FOLDER/<format>`, and `FOLDER/expected/<n>.npz`: of each episode the state, action, reward and success of
every step, and the images of each camera.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
from rcs_data import Dataset
from rcs_data.convert.formats import EXPORTS
from rcs_data.convert.options import ExportOptions
from rcs_data.read.trajectory import action_layout, camera_features, state_layout, trajectory

from rcs.cli.main import main as rcs

folder = Path(sys.argv[1])
wanted = sys.argv[2:] or [*EXPORTS, "lerobot-v3-av1"]
source = folder / "source"
if not source.exists():
    try:
        rcs(
            f"collect PickCuboid --robot fr3 --episodes 3 --out {source} --seed 5 --workers 1 "
            "--cameras wrist side --image-size 96 --depth".split()
        )
    except SystemExit as stopped:
        if stopped.code:
            raise

dataset = Dataset.open(source)
state, action = state_layout(dataset.info), action_layout(dataset.info)
cameras = camera_features(dataset.info)
depths = camera_features(dataset.info, "depth")
(folder / "expected").mkdir(exist_ok=True)
for index, episode in enumerate(dataset.episodes):
    flow = trajectory(episode, state, action)
    images = {f"image_{name}": episode.column(f.key)[:-1] for name, f in cameras.items()}
    images |= {f"depth_{name}": episode.column(f.key)[:-1] for name, f in depths.items()}
    np.savez(
        folder / "expected" / f"{index}.npz",
        state=flow.states,
        action=flow.actions,
        reward=flow.rewards,
        success=np.array(bool(episode.success)),
        **images,
    )
about = {
    "episodes": len(dataset),
    "fps": dataset.info.frequency,
    "cameras": list(cameras),
    "depths": list(depths),
    "state": [feature.key for feature in state.features],
    "task": dataset.info.instruction,
}
(folder / "expected" / "about.json").write_text(json.dumps(about))

for name in wanted:
    out = folder / name
    if out.is_dir():
        shutil.rmtree(out)
    out.unlink(missing_ok=True)
    is_av1 = name.endswith("-av1")
    options = ExportOptions(workers=2, codec="av1" if is_av1 else "h264")
    report = EXPORTS[name.removesuffix("-av1")](dataset, out, options)
    print(f"{name}: {report.steps} steps, {report.frames} images, {report.bytes_written} bytes")
