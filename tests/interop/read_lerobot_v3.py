"""Opens an export with LeRobot 0.4.4: every frame, windows, two workers, statistics, and a few steps of training ACT.

Run with the interpreter that has it: `python read_lerobot_v3.py EXPORT EXPECTED`. Prints one line of JSON.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import lerobot_reader
import torch
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.aggregate import aggregate_stats
from lerobot.datasets.lerobot_dataset import LeRobotDataset

lerobot_dataset.decode_video_frames = lerobot_reader.decode_frames


def main() -> None:
    """Compare, then train."""
    root, expected = lerobot_reader.arguments()
    dataset = LeRobotDataset("local/rcs", root=root, video_backend="pyav")
    found = lerobot_reader.compare(dataset, expected)

    # Statistics must have the forms that LeRobot checks when it merges datasets.
    aggregate_stats([dataset.meta.stats, dataset.meta.stats])

    step = 1 / dataset.fps
    windows = LeRobotDataset(
        "local/rcs",
        root=root,
        video_backend="pyav",
        delta_timestamps={
            "observation.images.side": [-step, 0.0],
            "observation.state": [-step, 0.0],
            "action": [i * step for i in range(8)],
        },
    )
    batch = next(iter(torch.utils.data.DataLoader(windows, batch_size=4, num_workers=2, shuffle=True)))
    assert batch["action"].shape[:2] == (4, 8), batch["action"].shape
    assert batch["observation.images.side"].shape[:2] == (4, 2), batch["observation.images.side"].shape

    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "train"
        sys.argv = [
            "lerobot-train", "--dataset.repo_id=local/rcs", f"--dataset.root={root}", "--dataset.video_backend=pyav",
            "--policy.type=act", "--policy.device=cpu", "--policy.push_to_hub=false",
            "--policy.pretrained_backbone_weights=null", "--policy.dim_model=32", "--policy.n_heads=2",
            "--policy.dim_feedforward=64", "--policy.chunk_size=8", "--policy.n_action_steps=8", "--batch_size=4",
            "--num_workers=0", "--steps=4", "--save_freq=4", "--eval_freq=0", "--wandb.enable=false",
            f"--output_dir={out}",
        ]  # fmt: skip
        from lerobot.scripts.lerobot_train import main as train

        train()
        assert list(out.glob("checkpoints/*/pretrained_model/model.safetensors")), list(out.rglob("*"))
    print(json.dumps({"reader": "lerobot 0.4.4", "export": root.name, **found, "trained_act_steps": 4}))


if __name__ == "__main__":
    main()
