"""Writes small datasets with TensorFlow Datasets itself, in the style of Open X-Embodiment, Bridge and DROID.

Run with the interpreter that has it: `python write_rlds.py FOLDER`. Beside each dataset, `NAME.npz` has what TensorFlow
Datasets reads from it: each feature of each episode as "0/observation/image", images encoded.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"

import numpy as np
import tensorflow_datasets as tfds
from tensorflow_datasets import features as f

folder = Path(sys.argv[1])
rng = np.random.default_rng(5)
LENGTHS = (5, 7, 4)


def numbers(*shape: int, dtype: type = np.float32) -> f.Tensor:
    """Return an array in the description of a dataset."""
    return f.Tensor(shape=shape, dtype=dtype)


COMMON = {"is_first": f.Scalar(np.bool_), "is_last": f.Scalar(np.bool_), "is_terminal": f.Scalar(np.bool_)}
REWARD = {"reward": f.Scalar(np.float32), "discount": f.Scalar(np.float32)}
JPEG = {"encoding_format": "jpeg"}
STEPS = {
    # RT-1: actions are a dictionary, the words are observed, the last step is terminal.
    "fractal": {
        "observation": {
            "image": f.Image(shape=(24, 32, 3), **JPEG),
            "natural_language_instruction": f.Text(),
            "natural_language_embedding": numbers(512),
            "base_pose_tool_reached": numbers(7),
            "gripper_closed": numbers(1),
            "orientation_box": numbers(2, 3),
        },
        "action": {"world_vector": numbers(3), "terminate_episode": numbers(3, dtype=np.int32)},
        "reward": f.Scalar(np.float32),
        **COMMON,
    },
    "bridge": {
        "observation": {
            "image_0": f.Image(shape=(24, 32, 3), **JPEG),
            "image_1": f.Image(shape=(None, None, 3), **JPEG),
            "state": numbers(7),
            "depth": f.Image(shape=(6, 8, 1), dtype=np.uint16, encoding_format="png"),
        },
        "action": numbers(7),
        "language_instruction": f.Text(),
        "language_embedding": numbers(512),
        **REWARD,
        **COMMON,
    },
    "droid": {
        "observation": {
            "exterior_image_1_left": f.Image(shape=(18, 32, 3), **JPEG),
            "wrist_image_left": f.Image(shape=(18, 32, 3), encoding_format="png"),
            "joint_position": numbers(7, dtype=np.float64),
            "gripper_position": numbers(1, dtype=np.float64),
        },
        "action": numbers(7, dtype=np.float64),
        "action_dict": {
            "joint_velocity": numbers(7, dtype=np.float64),
            "gripper_position": numbers(1, dtype=np.float64),
        },
        "language_instruction": f.Text(),
        "language_instruction_2": f.Text(),
        **REWARD,
        **COMMON,
    },
}
METADATA = {
    "fractal": {},
    "bridge": {"episode_metadata": f.FeaturesDict({"file_path": f.Text(), "has_language": f.Scalar(np.bool_)})},
    "droid": {"episode_metadata": f.FeaturesDict({"recording_folderpath": f.Text(), "file_path": f.Text()})},
}


def drawn(path: str, feature: object, step: int, length: int) -> object:
    """Return any value of a feature in a step."""
    name = path.rpartition("/")[2]
    if isinstance(feature, dict):
        return {key: drawn(f"{path}/{key}", inner, step, length) for key, inner in feature.items()}
    if name in COMMON:
        return step == (0 if name == "is_first" else length - 1)
    if isinstance(feature, f.Text):
        return f"move it, part {step // 3}" if "2" in name else "push the block"
    if isinstance(feature, f.Image):
        height, width, channels = (n or 20 for n in feature.shape)
        if feature.dtype == np.uint16:
            return rng.integers(0, 65536, (height, width, channels), np.uint16)
        smooth = np.add.outer(np.arange(height) * 3, np.arange(width) * 2)[..., None]
        return (smooth + rng.integers(0, 90, channels)).astype(np.uint8)
    return rng.integers(0, 9, feature.shape).astype(feature.np_dtype)


class Written(tfds.core.GeneratorBasedBuilder, skip_registration=True):
    """Writes a dataset of any description."""

    VERSION = tfds.core.Version("0.1.0")

    @classmethod
    def get_metadata(cls):
        """Say that there are no files with a description beside this one."""
        return tfds.core.dataset_metadata.DatasetMetadata()

    def _info(self):
        described = f.FeaturesDict({"steps": f.Dataset(STEPS[self.name]), **METADATA[self.name]})
        return tfds.core.DatasetInfo(builder=self, description=self.name, features=described)

    def _split_generators(self, dl_manager):
        return {"train": self._generate_examples(range(2)), "val": self._generate_examples(range(2, 3))}

    def _generate_examples(self, episodes):
        for index in episodes:
            steps = [drawn("", STEPS[self.name], step, LENGTHS[index]) for step in range(LENGTHS[index])]
            about = {"has_language": True, "file_path": f"/data/{index}", "recording_folderpath": "/data"}
            metadata = {key: {name: about[name] for name in inner} for key, inner in METADATA[self.name].items()}
            yield index, {"steps": steps, **metadata}


def flat(path: str, value: object) -> dict[str, object]:
    """Return the leaves of nested dictionaries by path."""
    if not isinstance(value, dict):
        return {path: value}
    return {k: v for key, inner in value.items() for k, v in flat(f"{path}/{key}", inner).items()}


for dataset in STEPS:
    Written.name = dataset
    builder = Written(data_dir=folder)
    builder.download_and_prepare()
    episodes = [
        episode
        for split in ("train", "val")
        for episode in tfds.as_numpy(builder.as_dataset(split=split, decoders={"steps": tfds.decode.SkipDecoding()}))
    ]
    truth = {k: v for index, episode in enumerate(episodes) for k, v in flat(str(index), episode["steps"]).items()}
    np.savez(folder / f"{dataset}.npz", **truth)
    print(dataset, [len(episode["steps"]["is_first"]) for episode in episodes])
