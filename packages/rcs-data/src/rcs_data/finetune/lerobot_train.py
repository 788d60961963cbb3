"""Trains a policy with LeRobot on an export of a dataset: begins a run, or goes on with one that was ended.

`rcs-data recipe act` writes this program beside `lerobot.json`, for LeRobot's own environment:

    python lerobot_train.py EXPORT RUN [--steps=20000 --batch_size=32 --policy.dim_model=512 …]

What follows the run's folder is LeRobot's own options; without, they are those of `lerobot.json`. The same command goes
on from the run's last checkpoint. Small frames are kept in memory. A backbone without published weights begins with the
statistics of the data in its normalisation, which LeRobot freezes.
"""

# pyright: reportMissingImports=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownParameterType=false, reportAttributeAccessIssue=false, reportUntypedBaseClass=false

from __future__ import annotations

import importlib
import json
import os
import sys
from pathlib import Path
from typing import Any

os.environ.setdefault(
    "HF_HUB_OFFLINE", "1"
)  # datasets are here; set it to 0 for a model that begins with published weights

import av
import numpy as np
import torch
from vlagents.policies.torch_stack import import_stack

import_stack("lerobot", "lerobot")  # torchvision, too, beside a torch for the CPU

from lerobot.datasets import lerobot_dataset  # noqa: E402
from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402
from lerobot.scripts import lerobot_train  # noqa: E402
from torchvision.ops.misc import FrozenBatchNorm2d  # noqa: E402

MOST_IN_MEMORY = 8 << 30
"""Bytes of frames that are kept in memory; of a larger dataset, LeRobot decodes them anew in every epoch."""
BEGUN_WITH = 256
"""Frames of each camera from which the normalisation of a backbone begins."""

_used: dict[str, Any] = {}


class InMemory(torch.utils.data.Dataset[dict[str, Any]]):
    """The rows of a LeRobotDataset as it gives them, without its reading and decoding."""

    def __init__(self, inner: LeRobotDataset) -> None:
        """Read and decode everything.

        Raises:
            RuntimeError: A row is not what LeRobot itself reads.
        """
        self.inner, self.meta = inner, inner.meta
        table = inner.hf_dataset.data.table
        self._episode = table.column("episode_index").to_numpy()
        self._task = table.column("task_index").to_numpy()
        starts = np.flatnonzero(np.diff(self._episode, prepend=-1))
        of = np.searchsorted(starts, np.arange(len(self._episode)), side="right") - 1
        self._first = starts[of]
        self._last = (np.append(starts[1:], len(self._episode)) - 1)[of]
        self._numbers = {
            key: _column(table.column(key)) for key in ("observation.state", "action") if key in table.column_names
        }
        self._offsets = {key: np.asarray(rows) for key, rows in (inner.delta_indices or {}).items()}
        self._frames = {key: self._decoded(key) for key in inner.meta.video_keys}
        row = len(self) // 2
        for key, value in inner[row].items():
            mine: Any = self[row].get(key)
            if isinstance(mine, torch.Tensor) and not torch.allclose(mine * 1.0, value * 1.0, atol=2e-3):
                raise RuntimeError(f"Row {row} has another {key!r} than LeRobot reads; set MOST_IN_MEMORY to 0.")

    @property
    def num_frames(self) -> int:
        """How many rows there are."""
        return len(self)

    @property
    def num_episodes(self) -> int:
        """How many episodes there are."""
        return self.inner.num_episodes

    @property
    def episodes(self) -> list[int] | None:
        """Numbers of the episodes that are used; None for all."""
        return self.inner.episodes

    def __len__(self) -> int:
        """Return how many rows there are."""
        return len(self._episode)

    def __getitem__(self, row: int) -> dict[str, Any]:
        """Return a row as LeRobot does: with times before and after it, as the policy asks."""
        found: dict[str, Any] = {"task": self.meta.tasks.iloc[self._task[row]].name}
        for key, values in (*self._numbers.items(), *self._frames.items()):
            rows: Any = row
            if key in self._offsets:
                rows = row + self._offsets[key]
                inside = np.clip(rows, self._first[row], self._last[row])
                found[f"{key}_is_pad"] = torch.from_numpy(rows != inside)
                rows = inside
            value = values[rows]
            if key in self._frames:
                value: Any = value.float() / 255
                value = value[0] if key in self._offsets and len(rows) == 1 else value
            found[key] = value
        return found

    def _decoded(self, key: str) -> torch.Tensor:
        """Return all frames of a camera, (rows, 3, height, width)."""
        parts: dict[Path, tuple[torch.Tensor, float]] = {}
        shown: list[torch.Tensor] = []
        for number in range(self.meta.total_episodes):
            path = self.inner.root / self.meta.get_video_file_path(number, key)
            if path not in parts:
                parts = {path: _video(path)}
            frames, rate = parts[path]
            start = round(self.meta.episodes[number][f"videos/{key}/from_timestamp"] * rate)
            shown.append(frames[start : start + int((self._episode == number).sum())])
        return torch.cat(shown)


def _column(values: Any) -> torch.Tensor:
    rows = values.combine_chunks()
    return torch.from_numpy(rows.flatten().to_numpy(zero_copy_only=False).astype(np.float32).reshape(len(rows), -1))


def _video(path: Path) -> tuple[torch.Tensor, float]:
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        stream.thread_type = "AUTO"
        frames = np.stack([frame.to_ndarray(format="rgb24") for frame in file.decode(stream)])
        return torch.from_numpy(frames).permute(0, 3, 1, 2).contiguous(), float(stream.average_rate or 0)


def frames_at(
    path: Path | str, times: list[float], tolerance: float, backend: str | None = None, **_: Any
) -> torch.Tensor:
    """Return the frames of a video at some times [s], (times, 3, height, width) from 0 to 1, as LeRobot's decoder does.

    Raises:
        ValueError: There is none within the tolerance [s].
    """
    found: list[tuple[float, Any]] = []
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        file.seek(max(0, int(min(times) / (stream.time_base or 1))), stream=stream)  # to the key frame before
        for frame in file.decode(stream):
            found.append((frame.time or 0.0, frame))
            if found[-1][0] >= max(times):
                break
    away = np.abs(np.subtract.outer(times, [time for time, _ in found]))
    if not found or away.min(1).max() > tolerance:
        raise ValueError(f"{path} has no frames at {times} s within {tolerance} s.")
    shown = np.stack([found[i][1].to_ndarray(format="rgb24") for i in away.argmin(1)])
    return torch.from_numpy(shown).permute(0, 3, 1, 2).float() / 255


def read_videos() -> None:
    """Have PyAV read videos where torchcodec cannot, which LeRobot reads them with."""
    try:
        importlib.import_module("torchcodec")
    except (ImportError, OSError, RuntimeError):
        sys.stderr.write(
            "torchcodec does not work here: it is not installed, or finds no FFmpeg (Debian: apt-get install ffmpeg). "
            "PyAV reads the videos in its place; that takes longer where they do not fit into memory.\n"
        )
        lerobot_dataset.decode_video_frames = frames_at


def make_dataset(config: Any) -> Any:
    """Return LeRobot's dataset, in memory if there is room."""
    dataset = _makers["dataset"](config)
    shapes = [dataset.meta.features[key]["shape"] for key in dataset.meta.video_keys]
    size = dataset.num_frames * sum(int(np.prod(shape)) for shape in shapes)
    _used["dataset"] = InMemory(dataset) if size <= MOST_IN_MEMORY and dataset.episodes is None else dataset
    return _used["dataset"]


def make_policy(config: Any = None, **given: Any) -> Any:
    """Return LeRobot's policy; a new one begins with normalisation that suits the data."""
    config = given.pop("cfg", config)
    policy = _makers["policy"](cfg=config, **given)
    is_new = not config.pretrained_path and getattr(config, "pretrained_backbone_weights", "") is None
    if is_new and hasattr(policy.model, "backbone"):
        begin_normalisation(policy, _used["dataset"])
    return policy


def begin_normalisation(policy: Any, dataset: Any) -> None:
    """Set the frozen statistics of a backbone to those of the data, as batch normalisation would have them at first."""
    rows = torch.randperm(len(dataset), generator=torch.Generator().manual_seed(0))[:BEGUN_WITH]
    items = [dataset[int(row)] for row in rows]
    stats = dataset.meta.stats
    pictures = []
    for key in policy.config.image_features:
        mean, deviation = (torch.tensor(np.asarray(stats[key][name]), dtype=torch.float32) for name in ("mean", "std"))
        pictures.append(
            (torch.stack([item[key] for item in items]) - mean.view(1, 3, 1, 1)) / deviation.view(1, 3, 1, 1)
        )

    def set_statistics(module: Any, given: tuple[torch.Tensor]) -> None:
        module.running_mean.copy_(given[0].mean((0, 2, 3)))
        module.running_var.copy_(given[0].var((0, 2, 3)))

    backbone = policy.model.backbone
    hooks = [
        module.register_forward_pre_hook(set_statistics)
        for module in backbone.modules()
        if isinstance(module, FrozenBatchNorm2d)
    ]
    with torch.no_grad():
        backbone(torch.cat(pictures).to(next(backbone.parameters()).device))
    for hook in hooks:
        hook.remove()


def arguments(export: Path, run: Path, more: list[str]) -> list[str]:
    """Return LeRobot's options: of a new run, or to go on with one."""
    last = run / "checkpoints" / "last" / "pretrained_model" / "train_config.json"
    if last.is_file():
        return [f"--config_path={last}", "--resume=true", *more]
    if run.exists():  # a run that was ended before its first checkpoint
        run.rename(run.with_name(f"{run.name}.{sum(1 for _ in run.parent.glob(f'{run.name}.*'))}"))
    options = json.loads(Path(__file__).with_name("lerobot.json").read_text(encoding="utf-8"))
    device = "cuda" if torch.cuda.is_available() else "cpu"
    options |= {"dataset.root": str(export), "output_dir": str(run), "policy.device": device}
    given = {option.partition("=")[0] for option in more}
    return [*(f"--{key}={value}" for key, value in options.items() if f"--{key}" not in given), *more]


_makers = {"dataset": lerobot_train.make_dataset, "policy": lerobot_train.make_policy}

if __name__ == "__main__":
    if len(sys.argv) < 3 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    os.environ.setdefault("ACCELERATE_MIXED_PRECISION", "bf16")
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", str(torch.get_num_threads()))))
    sys.argv[1:] = arguments(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
    read_videos()
    lerobot_train.make_dataset, lerobot_train.make_policy = make_dataset, make_policy
    lerobot_train.main()
