"""Opens an RLDS export with TensorFlow Datasets, and fails where a value is not what was exported.

Run with the interpreter that has it: `python read_rlds.py EXPORT EXPECTED`. Prints one line of JSON.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"

import numpy as np
import tensorflow as tf
import tensorflow_datasets as tfds

# Of 255, mean of an image: TensorFlow decodes JPEG by a fast transform unless told otherwise.
_FAST_DECODER_ERROR = 2


def main() -> None:
    """Compare every step, then read as Octo and OpenVLA do: by name, without decoding, a part of the episodes."""
    export, expected = Path(sys.argv[1]), Path(sys.argv[2])
    about = json.loads((expected / "about.json").read_text())
    (folder,) = export.glob("*/*/features.json")
    builder = tfds.builder_from_directory(str(folder.parent))
    assert builder.info.splits["train"].num_examples == about["episodes"], builder.info
    files = sum(file.stat().st_size for file in folder.parent.glob("*.tfrecord-*"))
    assert builder.info.splits["train"].num_bytes == files - 16 * about["episodes"], builder.info
    steps, worst = 0, 0.0
    for index, episode in enumerate(tfds.as_numpy(builder.as_dataset(split="train"))):
        truth = np.load(expected / f"{index}.npz")
        assert episode["episode_metadata"]["success"] == int(truth["success"]), index
        found = list(episode["steps"])
        assert len(found) == len(truth["action"]), index
        steps += len(found)
        for step, item in enumerate(found):
            is_last = step == len(found) - 1
            seen = item["observation"]
            assert (item["is_first"], item["is_last"]) == (step == 0, is_last), step
            assert item["language_instruction"].decode() == about["task"], item["language_instruction"]
            np.testing.assert_array_equal(seen["state"], truth["state"][step].astype(np.float32))
            np.testing.assert_array_equal(item["action"], truth["action"][step].astype(np.float32))
            assert item["reward"] == np.float32(truth["reward"][step]), step
            assert item["discount"] == 1 - item["is_terminal"], step
            for name in truth.files:
                kind, _, part = name.partition("_")
                if kind == "part":
                    values = truth[name][step]
                    values = values.astype(np.float32) if values.dtype == np.float64 else values
                    assert seen[part].dtype == values.dtype, (part, seen[part].dtype)
                    np.testing.assert_array_equal(seen[part], values)
                elif kind == "depth":
                    np.testing.assert_array_equal(seen[name][..., 0], truth[name][step])
                elif kind == "image":
                    worst = max(worst, float(np.abs(seen[name].astype(int) - truth[name][step]).mean()))
    assert index == about["episodes"] - 1, index
    assert worst <= _FAST_DECODER_ERROR, worst

    name = folder.parent.parent.name
    by_name = tfds.builder(name, data_dir=str(export))
    raw = by_name.as_dataset(split="train", decoders={"steps": tfds.decode.SkipDecoding()})
    for index, episode in enumerate(raw):
        truth = np.load(expected / f"{index}.npz")
        for camera in about["cameras"]:
            for step, data in enumerate(episode["steps"]["observation"][f"image_{camera}"]):
                is_jpeg = data.numpy().startswith(b"\xff\xd8")
                image = tf.io.decode_jpeg(data, dct_method="INTEGER_ACCURATE") if is_jpeg else tf.io.decode_png(data)
                np.testing.assert_array_equal(image, truth[f"image_{camera}"][step])
                assert tf.io.decode_image(data, expand_animations=False).shape == image.shape
    some = by_name.as_dataset(split=f"train[:{about['episodes'] - 1}]")
    assert sum(1 for _ in some) == about["episodes"] - 1
    print(
        json.dumps(
            {
                "reader": f"tensorflow_datasets {tfds.__version__}",
                "export": export.name,
                "episodes": about["episodes"],
                "steps": steps,
                "worst_image_error": 0,
                "worst_image_error_fast_decoder": round(worst, 2),
            }
        )
    )


if __name__ == "__main__":
    main()
