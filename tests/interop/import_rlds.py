"""Imports what `write_rlds.py` wrote with TensorFlow Datasets, and fails where a value is not what was written.

Run with the project's own interpreter: `python import_rlds.py FOLDER`. Prints one line of JSON.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from rcs_data import Windows, check
from rcs_data.convert.formats import import_format
from rcs_data.convert.labels import row_texts
from rcs_data.convert.options import ImportOptions
from rcs_data.files.codec import decode_png

# Features by column; a number is how many rows later it is, an action after what was seen.
COLUMNS = {
    "fractal": {
        "observation/base_pose_tool_reached": ("observation/base_pose_tool_reached", 0),
        "observation/natural_language_embedding": ("imported/natural_language_embedding", 0),
        "observation/orientation_box": ("observation/orientation_box", 0),
        "action/world_vector": ("action/world_vector", 1),
        "action/terminate_episode": ("action/terminate_episode", 1),
        "reward": ("reward", 1),
        "is_terminal": ("terminated", 1),
    },
    "bridge": {
        "observation/state": ("observation/state", 0),
        "language_embedding": ("imported/language_embedding", 0),
        "action": ("action/action", 1),
        "discount": ("imported/discount", 0),
    },
    "droid": {
        "observation/joint_position": ("observation/joint_position", 0),
        "action": ("action/action", 1),
        "action_dict/joint_velocity": ("action_dict/joint_velocity", 1),
    },
}
IMAGES = {"fractal": ("image",), "bridge": ("image_0", "image_1"), "droid": ("exterior_image_1_left",)}

PNGS = {"bridge": {"depth": "depth"}, "droid": {"wrist_image_left": "rgb"}}


def main() -> None:
    """Compare every episode."""
    folder = Path(sys.argv[1])
    jpegs = 0
    for name, columns in COLUMNS.items():
        truth = np.load(folder / f"{name}.npz", allow_pickle=True)
        with tempfile.TemporaryDirectory() as place:
            read = import_format("auto", folder / name)
            dataset = read(folder / name, Path(place) / "out", ImportOptions(frequency=5))
            assert len(dataset) == 3, dataset
            for index, episode in enumerate(dataset):
                steps = len(truth[f"{index}/is_first"])
                assert (episode.length, episode.instruction) == (steps + 1, "push the block"), episode.about
                imported = episode.outcome["imported"]
                assert imported["split"] == ("val" if index == 2 else "train"), imported
                for path, (key, later) in columns.items():
                    values = episode.column(key)[later : later + steps]
                    np.testing.assert_array_equal(values, truth[f"{index}/{path}"], err_msg=f"{name} {path}")
                for camera in IMAGES[name]:
                    stored = list(episode.encoded_frames(f"observation/frames/{camera}/rgb"))[:-1]
                    assert stored == list(truth[f"{index}/observation/{camera}"]), camera
                    jpegs += len(stored)
                for camera, kind in {"bridge": (("depth", "depth"),), "droid": (("wrist_image_left", "rgb"),)}.get(
                    name, ()
                ):
                    frames = episode.column(f"observation/frames/{camera}/{kind}")[:-1]
                    for frame, data in zip(frames, truth[f"{index}/observation/{camera}"], strict=True):
                        image = decode_png(data, frame.shape, frame.dtype.name)
                        assert np.abs(image.astype(int) - frame).max() <= (0 if kind == "depth" else 9)
            if name == "droid":
                texts = row_texts(dataset.episodes[1], "imported/language_instruction_2")
                assert texts[:-1] == [f"move it, part {step // 3}" for step in range(7)], texts
            assert check(dataset.path).is_ok, check(dataset.path)
            assert len(Windows(dataset, horizon=4)) == 16
    print(json.dumps({"imported": list(COLUMNS), "jpegs_kept": jpegs}))


if __name__ == "__main__":
    main()
