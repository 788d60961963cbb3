"""Trains a policy with LeRobot on an export of a dataset: begins a run, or goes on with one that was ended.

In LeRobot's own environment, with the options that `rcs-data recipe act` writes:

    python -m vlagents.policies.lerobot_train lerobot.json EXPORT RUN [--steps=20000 --batch_size=32 …]

Options after the run's folder are LeRobot's own and take precedence over those of the file. The same command goes on
from the run's last checkpoint. It ends with the command that LeRobot's documentation has, `lerobot-train`; a policy
whose backbone has no published weights begins with a checkpoint, made here, that has the statistics of the data in its
normalisation, which LeRobot freezes.
"""

from __future__ import annotations

import importlib
import json
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vlagents.policies.stack import import_stack

BEGUN_WITH = 256
"""Frames of each camera from which the normalisation of a backbone begins."""
MOST_PIXELS = 32_000_000
"""Most pixels of all these frames together; their first features take some GB."""


def main(words: Sequence[str]) -> None:
    """Train; the words are the file of options, the export, the run's folder, and LeRobot's options."""
    if len(words) < 3 or any(word.startswith("-") for word in words[:3]):
        sys.exit(__doc__)
    os.environ.setdefault("HF_HUB_OFFLINE", "1")  # datasets are here; set it to 0 for published weights
    os.environ.setdefault("ACCELERATE_MIXED_PRECISION", "bf16")
    torch, trainer = import_stack("lerobot", "torch", "lerobot.scripts.lerobot_train")
    require_torchcodec()
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", str(torch.get_num_threads()))))
    file, export, run = map(Path, words[:3])
    sys.argv[1:] = resumed(run, words[3:]) or begun(torch, file, export, run, words[3:])
    trainer.main()


def require_torchcodec() -> None:
    """End with what to do if LeRobot cannot read videos."""
    try:
        importlib.import_module("torchcodec")
    except (ImportError, OSError, RuntimeError):
        sys.exit(
            "error: torchcodec, with which LeRobot reads videos, is not installed or finds no FFmpeg "
            "(Debian: apt-get install ffmpeg)."
        )


def resumed(run: Path, more: Sequence[str]) -> list[str]:
    """Return LeRobot's options to go on with a run; none if it has no checkpoint.

    A run that was ended before its first checkpoint is moved aside, since LeRobot wants a folder that is not there.
    """
    last = run / "checkpoints" / "last" / "pretrained_model" / "train_config.json"
    if last.is_file():
        return [f"--config_path={last}", "--resume=true", *more]
    if run.exists():
        run.rename(run.with_name(f"{run.name}.{sum(1 for _ in run.parent.glob(f'{run.name}.*'))}"))
    return []


def begun(torch: Any, file: Path, export: Path, run: Path, more: Sequence[str]) -> list[str]:
    """Return LeRobot's options of a new run."""
    options: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    for word in more:
        name, _, value = word.removeprefix("--").partition("=")
        options[name] = value
    options |= {"dataset.root": str(export), "output_dir": str(run)}
    options.setdefault("policy.device", "cuda" if torch.cuda.is_available() else "cpu")
    if options.get("policy.type") == "act" and options.get("policy.pretrained_backbone_weights", "") is None:
        policy = {name.partition(".")[2]: value for name, value in options.items() if name.startswith("policy.")}
        kept = {f"policy.{name}": policy[name] for name in ("device", "push_to_hub") if name in policy}
        options = {name: value for name, value in options.items() if not name.startswith("policy.")} | kept
        options["policy.path"] = begin(torch, options, policy, run.with_name(f"{run.name}-begun"))
    return _words(options)


def begin(torch: Any, options: dict[str, Any], policy: dict[str, Any], folder: Path) -> str:
    """Save a policy that has learned nothing yet, and return its folder.

    The frozen statistics of its backbone are those of the data, as batch normalisation would have them at first.

    Args:
        torch: The package.
        options: LeRobot's options by name.
        policy: Those of the policy, by name without `policy.`.
        folder: Where to.
    """
    _, factory, datasets, configs, layers = import_stack(
        "lerobot",
        "torch",
        "lerobot.policies.factory",
        "lerobot.datasets.lerobot_dataset",
        "lerobot.configs.policies",
        "torchvision.ops.misc",
    )
    torch.manual_seed(int(options.get("seed", 0)))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.json").write_text(json.dumps({"type": policy.pop("type")}), encoding="utf-8")
    config = configs.PreTrainedConfig.from_pretrained(folder, cli_overrides=_words(policy))
    dataset = datasets.LeRobotDataset(
        str(options["dataset.repo_id"]),
        root=options["dataset.root"],
        video_backend=options.get("dataset.video_backend"),
    )
    model = factory.make_policy(config, ds_meta=dataset.meta)
    set_statistics(torch, layers.FrozenBatchNorm2d, model, dataset)
    model.save_pretrained(folder)
    for step in factory.make_pre_post_processors(config, dataset_stats=dataset.meta.stats):
        step.save_pretrained(folder)
    return str(folder)


def set_statistics(torch: Any, frozen: type[Any], model: Any, dataset: Any) -> None:
    """Set the frozen statistics of a model's backbone to those of the dataset's frames."""
    pixels = sum(math.prod(feature.shape[-2:]) for feature in model.config.image_features.values())
    count = min(BEGUN_WITH, max(MOST_PIXELS // pixels, 16))
    rows = torch.randperm(len(dataset), generator=torch.Generator().manual_seed(0))[:count]
    items = [dataset[int(row)] for row in rows]
    frames: list[Any] = []
    for key in model.config.image_features:
        mean, deviation = (torch.as_tensor(dataset.meta.stats[key][name]).float() for name in ("mean", "std"))
        frames.append((torch.stack([item[key] for item in items]) - mean) / deviation)

    def set_own(module: Any, given: tuple[Any]) -> None:
        module.running_mean.copy_(given[0].mean((0, 2, 3)))
        module.running_var.copy_(given[0].var((0, 2, 3)))

    backbone = model.model.backbone
    hooks = [part.register_forward_pre_hook(set_own) for part in backbone.modules() if isinstance(part, frozen)]
    size = frames[0].shape[2:]  # one batch needs one size; for mean and variance, a nearby one does
    alike = [one if one.shape[2:] == size else torch.nn.functional.interpolate(one, size=tuple(size)) for one in frames]
    with torch.no_grad():
        backbone(torch.cat(alike).to(next(backbone.parameters()).device))
    for hook in hooks:
        hook.remove()


def _words(options: dict[str, Any]) -> list[str]:
    return [f"--{name}={value if isinstance(value, str) else json.dumps(value)}" for name, value in options.items()]


if __name__ == "__main__":
    main(sys.argv[1:])
