"""LeRobot's trainer for a dataset: ACT, Diffusion Policy or SmolVLA, on a GPU or on the CPU.

What is written is a program for LeRobot's environment and the options of the policy. ACT is smaller than LeRobot's own,
so that a CPU trains it in an hour or two, and needs no published weights.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

from rcs_data.errors import InvalidSetup
from rcs_data.finetune.contents import Contents
from rcs_data.finetune.written import Written

LerobotPolicy = Literal["act", "diffusion", "smolvla"]
FILE, OPTIONS = "lerobot_train.py", "lerobot.json"
SECONDS = 1.0
"""Length of ACT's chunk [s]."""

_TRAINED: dict[str, Any] = {
    "policy.push_to_hub": "false",
    "wandb.enable": "false",
    "eval_freq": 0,
    "log_freq": 50,
    "save_freq": 1_000,
    "batch_size": 32,
    "num_workers": 0,
    "seed": 0,
}
_ACT: dict[str, Any] = {
    "policy.type": "act",
    "policy.pretrained_backbone_weights": "null",
    "policy.dim_model": 256,
    "policy.dim_feedforward": 1024,
    "policy.pre_norm": "true",
    "policy.use_vae": "false",
    "policy.optimizer_lr": 2e-4,
    "policy.optimizer_lr_backbone": 2e-4,
    "use_policy_training_preset": "false",
    "optimizer.type": "adamw",
    "optimizer.lr": 2e-4,
    "optimizer.weight_decay": 1e-4,
    "optimizer.grad_clip_norm": 10,
    "scheduler.type": "diffuser",
    "scheduler.name": "cosine",
    "scheduler.num_warmup_steps": 200,
    "steps": 12_000,
}
_DIFFUSION: dict[str, Any] = {
    "policy.type": "diffusion",
    "policy.crop_shape": "null",
    "policy.down_dims": "[128,256,512]",
    "steps": 20_000,
}
_SMOLVLA: dict[str, Any] = {"policy.path": "lerobot/smolvla_base", "steps": 20_000}


def lerobot(contents: Contents, policy: LerobotPolicy = "act") -> Written:
    """Return the program that trains a policy, its options, and the settings to serve it with.

    Raises:
        InvalidSetup: There is no camera, or no such policy.
    """
    options = {"act": _ACT, "diffusion": _DIFFUSION, "smolvla": _SMOLVLA}.get(policy)
    if options is None:
        raise InvalidSetup(f"The policy is {policy!r}; valid are act, diffusion and smolvla.")
    if not contents.cameras:
        raise InvalidSetup("The dataset has no camera, and these policies look at pictures.")
    chosen = {"dataset.repo_id": f"rcs/{contents.name}", **_TRAINED, **options}
    if policy == "act":
        rows = max(round(SECONDS * contents.rate), 1)
        chosen |= {"policy.chunk_size": rows, "policy.n_action_steps": rows}
    images = {camera.replace("/", "."): camera for camera in contents.cameras}
    return Written(
        files={
            FILE: Path(__file__).with_name(FILE).read_text(encoding="utf-8"),
            OPTIONS: json.dumps(chosen, indent=2) + "\n",
            "vlagents.json": contents.settings(images=images, has_state=True),
        },
        export_format="lerobot-v3",
        steps=(
            "rcs-data export DATASET --format lerobot-v3 --out EXPORT",
            f"ENVIRONMENT/bin/python FOLDER/{FILE} EXPORT RUN",
            f"ENVIRONMENT/bin/vlagents serve {policy} --checkpoint RUN --settings FOLDER/vlagents.json",
        ),
    )
