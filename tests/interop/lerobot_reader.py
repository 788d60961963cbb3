"""Helpers that the runners for LeRobot share: an importable torchvision, a video decoder, and the comparison itself.

torchvision's wheels are linked against CUDA: beside a torch for the CPU alone its extension does not load, and
importing it fails where it registers two operators of that extension. They are declared here first; nothing calls them.
Beside a torch with CUDA, which runs without a GPU too, the extension declares them itself, and twice is an error.

Its video reader is gone too, so LeRobot's decoder is replaced by one of PyAV that looks frames up as LeRobot does: by
time, within the tolerance that LeRobot gives.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"  # without it a dataset that does not load becomes a question to a server
os.environ["WANDB_MODE"] = "disabled"

import av
import numpy as np
import torch

if torch.version.cuda is None:
    _operators = torch.library.Library("torchvision", "DEF")
    _operators.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    _operators.define("qnms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")


def decode_frames(video_path, timestamps, tolerance_s, backend=None, **_):
    """Return the frames at some times, as LeRobot's own decoder does, or fail as it does."""
    wanted = sorted(timestamps)
    found = {}
    with av.open(str(video_path)) as source:
        stream = source.streams.video[0]
        source.seek(max(0, round((wanted[0] - tolerance_s) / stream.time_base)), stream=stream, backward=True)
        for frame in source.decode(stream):
            for time in wanted:
                if abs(frame.time - time) < tolerance_s:
                    found[time] = torch.from_numpy(frame.to_ndarray(format="rgb24")).permute(2, 0, 1)
            if frame.time > wanted[-1] + tolerance_s:
                break
    missing = [time for time in timestamps if time not in found]
    if missing:
        raise ValueError(f"{video_path} has no frames at {missing} within {tolerance_s} s")
    return torch.stack([found[time] for time in timestamps]).float() / 255


def arguments() -> tuple[Path, Path]:
    """Return the folder of the export and of what is expected, from the command line."""
    return Path(sys.argv[1]), Path(sys.argv[2])


def compare(dataset, expected: Path) -> dict[str, float]:
    """Go through all frames of a LeRobotDataset, and fail where one is not what was exported.

    Vectors must be equal as float32. In an image, the mean error of a pixel may be 4 and that of the whole 2.5 of 255:
    half of the resolution of colour is lost, and the decoder rounds down.
    """
    about = json.loads((expected / "about.json").read_text())
    assert dataset.meta.total_episodes == about["episodes"], dataset.meta.total_episodes
    assert dataset.fps == about["fps"], dataset.fps
    row, pixel, colour = 0, 0.0, 0.0
    for index in range(about["episodes"]):
        truth = np.load(expected / f"{index}.npz")
        steps = len(truth["action"])
        for step in range(steps):
            item = dataset[row]
            assert item["episode_index"] == index and item["frame_index"] == step and item["index"] == row, row
            assert item["task"] == about["task"], item["task"]
            for name, key in (("observation.state", "state"), ("action", "action")):
                np.testing.assert_array_equal(item[name].numpy(), truth[key][step].astype(np.float32))
            assert item["next.reward"] == np.float32(truth["reward"][step]), row
            assert bool(item["next.done"]) == (step == steps - 1), row
            assert bool(item["next.success"]) == (step == steps - 1 and bool(truth["success"])), row
            for camera in about["cameras"]:
                image = item[f"observation.images.{camera}"].permute(1, 2, 0).numpy() * 255
                error = image - truth[f"image_{camera}"][step]
                pixel = max(pixel, float(np.abs(error).mean()))
                colour = max(colour, float(np.abs(error.mean(axis=(0, 1))).max()))
            row += 1
    assert row == len(dataset), (row, len(dataset))
    assert pixel < 4 and colour < 2.5, (pixel, colour)
    every = [np.load(expected / f"{index}.npz") for index in range(about["episodes"])]
    for name, key in (("observation.state", "state"), ("action", "action")):
        values = np.concatenate([truth[key] for truth in every]).astype(np.float32).astype(np.float64)
        stats = dataset.meta.stats[name]
        for what in ("min", "max", "mean", "std"):
            np.testing.assert_allclose(np.asarray(stats[what]), getattr(values, what)(axis=0), rtol=1e-5, atol=1e-7)
        assert int(np.asarray(stats["count"])[0]) == row, stats["count"]
    for camera in about["cameras"]:
        mean = np.concatenate([truth[f"image_{camera}"].reshape(-1, 3) for truth in every]).mean(axis=0) / 255
        stats = np.asarray(dataset.meta.stats[f"observation.images.{camera}"]["mean"])
        assert stats.shape == (3, 1, 1), stats.shape
        np.testing.assert_allclose(stats.reshape(3), mean, atol=0.01)
    return {"frames": row, "worst_pixel_error": round(pixel, 3), "worst_colour_error": round(colour, 3)}
