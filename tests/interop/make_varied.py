"""Records a dataset of all that a feature can be, exports it to RLDS and for robomimic, and writes down the values.

Run with the project's own interpreter: `python make_varied.py FOLDER`. Two robots, colour with and without loss, depth,
integers and booleans, words in several scripts, a camera with a "/" in its name. It makes the same files as
`make_exports.py`.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature
from rcs_data.convert.formats import EXPORTS
from rcs_data.convert.options import ExportOptions
from rcs_data.read.trajectory import action_layout, camera_features, state_layout, trajectory

TASK = "Heb de kubus – 立方体を持ち上げる"
STEPS = 7

folder = Path(sys.argv[1])
source = folder / "source"
shutil.rmtree(folder, ignore_errors=True)
numbers = [
    Feature(key=f"{group}/{robot}/{name}", shape=shape, dtype=dtype)
    for group in ("observation", "action")
    for robot in ("left", "right")
    for name, shape, dtype in (("joints", (7,), "float64"), ("gripper", (1,), "float32"))
]
numbers += [
    Feature(key="observation/count", shape=(2,), dtype="int32"),
    Feature(key="observation/touch", shape=(3,), dtype="bool"),
    Feature(key="observation/clock", shape=(), dtype="uint64"),
    Feature(key="observation/frames/left/wrist/extrinsics", shape=(4, 4), dtype="float64"),
    Feature(key="reward", shape=(), dtype="float64"),
    Feature(key="terminated", shape=(), dtype="bool"),
]
images = [
    Feature(key="observation/frames/left/wrist/rgb", shape=(48, 64, 3), dtype="uint8", encoding="lossless"),
    Feature(key="observation/frames/left/wrist/depth", shape=(30, 40), dtype="uint16", encoding="depth"),
    Feature(key="observation/frames/top/rgb", shape=(32, 32, 3), dtype="uint8", encoding="jpeg"),
]
info = DatasetInfo(frequency=12.5, features=(*numbers, *images), setup={"task": "Varied"}, instruction=TASK)
rng = np.random.default_rng(3)


def draw(feature: Feature) -> np.ndarray:
    """Return any value of a feature, images smooth enough for JPEG."""
    if feature.encoding == "jpeg":
        return np.clip(
            np.add.outer(np.arange(32) * 5, np.arange(32) * 2)[..., None] + rng.integers(0, 30, 3), 0, 255
        ).astype(np.uint8)
    if feature.dtype.startswith("float"):
        return rng.normal(size=feature.shape).astype(feature.dtype)
    top = {"bool": 2, "uint8": 256, "uint16": 65536, "int32": 2**31 - 1, "uint64": 2**64 - 1}[feature.dtype]
    value = rng.integers(0, top, feature.shape, np.uint64).astype(feature.dtype)
    return -value if feature.dtype == "int32" else value


with DatasetWriter.open(source, info) as writer:
    for index in range(12):
        with writer.episode(f"episode {index:02d} é", seed=index or None) as episode:
            for row in range(STEPS + 1):
                values = {f.key: draw(f) for f in info.features if row or not f.is_unknown_at_reset}
                values["terminated"] = row == STEPS
                episode.add(values)
            episode.finish((True, False, None)[index % 3])

dataset = Dataset.open(source)
state, action = state_layout(dataset.info), action_layout(dataset.info)
cameras, depths = camera_features(dataset.info), camera_features(dataset.info, "depth")
(folder / "expected").mkdir()
for index, episode in enumerate(dataset.episodes):
    flow = trajectory(episode, state, action)
    frames = {f"image_{name.replace('/', '_')}": f.key for name, f in cameras.items()}
    frames |= {f"depth_{name.replace('/', '_')}": f.key for name, f in depths.items()}
    parts = ("count", "touch", "clock")
    np.savez(
        folder / "expected" / f"{index}.npz",
        state=flow.states,
        action=flow.actions,
        reward=flow.rewards,
        success=np.array(-1 if episode.success is None else int(episode.success)),
        **{name: episode.column(key)[:-1] for name, key in frames.items()},
        **{f"part_{name}": episode.column(f"observation/{name}")[:-1] for name in parts},
        part_extrinsics_left_wrist=episode.column("observation/frames/left/wrist/extrinsics")[:-1],
    )
about = {
    "episodes": len(dataset),
    "fps": dataset.info.frequency,
    "cameras": [name.replace("/", "_") for name in cameras],
    "depths": [name.replace("/", "_") for name in depths],
    "state": [feature.key for feature in state.features],
    "task": TASK,
}
(folder / "expected" / "about.json").write_text(json.dumps(about))
for name in ("rlds", "robomimic"):
    report = EXPORTS[name](dataset, folder / name, ExportOptions())
    print(
        f"{name}: {report.episodes} episodes, {report.steps} steps, {report.frames} images, "
        f"{report.bytes_written} bytes"
    )
