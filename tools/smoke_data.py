"""Whether an installed wheel of rcs-data works by itself: records, reads, checks, edits, converts, shows a dataset."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import tempfile
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import rcs_data
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature, Windows, check, convert, edit
from rcs_data.view import write_view

if Path(sysconfig.get_path("purelib")) not in Path(str(rcs_data.__file__)).parents:
    sys.exit(f"This is about an installed wheel; rcs_data is in {rcs_data.__file__}.")
if found := [name for name in ("rcs", "mujoco", "gymnasium") if find_spec(name) is not None]:
    sys.exit(f"rcs-data alone must not bring {', '.join(found)}.")

JOINTS, IMAGE, ACTION = "observation/joints", "observation/frames/wrist/rgb", "action/joints"
INFO = DatasetInfo(
    frequency=30.0,
    features=(
        Feature(key=JOINTS, shape=(6,), dtype="float64", unit="rad"),
        Feature(key=IMAGE, shape=(48, 64, 3), dtype="uint8", encoding="jpeg"),
        Feature(key=ACTION, shape=(6,), dtype="float64", unit="rad"),
    ),
    setup={},
    instruction="pick the cuboid",
)

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "dataset"
    with DatasetWriter.open(path, INFO) as writer:
        for number in range(3):
            with writer.episode(f"{number:06d}", seed=number) as episode:
                for i in range(40):
                    joints = np.full(6, 0.01 * i)
                    row = {JOINTS: joints, IMAGE: np.full((48, 64, 3), 3 * i, np.uint8)}
                    episode.add(row if i == 0 else {**row, ACTION: joints})
                episode.finish(number != 1)
    report = check(path)
    assert report.is_ok, str(report)
    edit.keep(path, [episode.id for episode in Dataset.open(path) if episode.success])
    edit.trim(path, "000000", first=2)
    dataset = Dataset.open(path)
    assert [episode.length for episode in dataset] == [38, 40]
    windows = Windows(dataset, history=2, horizon=4)
    assert windows.batch([0, 5])["images"]["wrist"].shape[-3:] in ((3, 48, 64), (48, 64, 3))
    convert.export_lerobot(dataset, Path(folder) / "lerobot")
    again = convert.import_lerobot(Path(folder) / "lerobot", Path(folder) / "again")
    assert [episode.length for episode in again] == [38, 40]
    assert write_view(path).path.is_file()
    command = Path(sysconfig.get_path("scripts")) / "rcs-data"
    told = subprocess.run([command, "info", path], check=True, capture_output=True, text=True).stdout
    assert "2" in told

print(f"rcs-data {version('rcs-data')} works with Python {sys.version.partition(' ')[0]}, NumPy {np.__version__}")
