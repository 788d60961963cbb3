"""Test an installed wheel of rcs-data alone: record, read, check, edit, convert and view a dataset."""

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
GRIPPER, POSE = "action/gripper", "observation/frames/wrist/extrinsics"
INFO = DatasetInfo(
    frequency=30.0,
    features=(
        Feature(key=JOINTS, shape=(6,), dtype="float64", unit="rad"),
        Feature(key=IMAGE, shape=(64, 96, 3), dtype="uint8", encoding="jpeg"),
        Feature(key=POSE, shape=(4, 4), dtype="float64", encoding="held"),
        Feature(key=GRIPPER, shape=(1,), dtype="float32"),
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
                    row = {JOINTS: joints, IMAGE: np.full((64, 96, 3), 3 * i, np.uint8), POSE: np.eye(4) * (i // 20)}
                    done = {ACTION: joints, GRIPPER: np.ones(1, np.float32)}
                    episode.add(row if i == 0 else {**row, **done})
                episode.finish(number != 1)
    report = check(path)
    assert report.is_ok, str(report)
    edit.keep(path, [episode.id for episode in Dataset.open(path) if episode.success])
    edit.trim(path, "000000", first=2)
    dataset = Dataset.open(path)
    assert [episode.length for episode in dataset] == [38, 40]
    windows = Windows(dataset, history=2, horizon=4)
    assert windows.batch([0, 5])["images"]["wrist"].shape[-3:] in ((3, 64, 96), (64, 96, 3))
    for codec in ("h264", "av1"):
        exported = Path(folder) / codec
        convert.export_lerobot(dataset, exported, convert.ExportOptions(codec=codec))
        again = convert.import_lerobot(exported, Path(folder) / f"again-{codec}")
        assert [episode.length for episode in again] == [38, 40]
        errors = again["000000"].column(IMAGE).astype(int) - dataset["000000"].column(IMAGE)
        assert np.abs(errors[:-1]).max() <= 4, codec  # the last observation is repeated
        assert (again["000000"].column(POSE)[:-1] == dataset["000000"].column(POSE)[:-1]).all()
    edit.resize(path, (48, 32))
    assert Dataset.open(path)["000000"].column(IMAGE).shape == (38, 32, 48, 3)
    assert write_view(path).path.is_file()
    command = Path(sysconfig.get_path("scripts")) / "rcs-data"
    subprocess.run([command, "relabel", path, "--instruction", "put it down"], check=True, capture_output=True)
    told = subprocess.run([command, "info", path], check=True, capture_output=True, text=True).stdout
    assert "put it down" in told

print(f"rcs-data {version('rcs-data')} works with Python {sys.version.partition(' ')[0]}, NumPy {np.__version__}")
