"""Training with several seeds at a time on a Ray cluster, each in a run of its own."""

from __future__ import annotations

import secrets
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rcs_data.durable import disk_errors

from rcs.errors import InvalidSetup
from rcs.rl.train import Progress, train
from rcs.rl.training import Training
from rcs.rollout.cluster import LOCAL
from rcs.rollout.ray_pool import RayPool
from rcs.rollout.remote_files import FileWorker, write_files


@dataclass(frozen=True, kw_only=True)
class Trained:
    """A run that is complete."""

    seed: int
    run: Path
    steps: int
    """Environment steps of the whole run."""
    seconds: float
    """Duration of the training [s]."""


def run_of(out: Path, seed: int) -> Path:
    """Return the folder of the run of a seed."""
    return out / f"seed-{seed}"


def train_seeds(
    training: Training,
    seeds: Sequence[int],
    out: str | Path,
    *,
    ray: str = LOCAL,
    cpus: int = 1,
    videos: bool = True,
) -> Generator[Trained]:
    """Train with each seed, and yield each run as it is complete; the folder of a seed is `out/seed-N`.

    The weights are those of a training alone with as many threads. A machine that sees the folder `out` trains in it:
    when its process or itself is lost, another continues from the last checkpoint. A machine that does not see it sends
    its run at the end; a run that is lost before begins anew. Closing the iterator ends all trainings as a kill does;
    the same call continues those that are in `out`.

    Args:
        training: What to train, but for the seed; without a number of torch's threads, it has `cpus`.
        seeds: The seeds, all different.
        out: The folder of the runs; created if missing.
        ray: Address of the cluster; see `rcs.rollout.cluster.connected`.
        cpus: CPUs of each training, and its threads. On `cuda` it has a GPU besides.
        videos: Whether each evaluation films an episode.

    Raises:
        MissingDependency: The extra `ray` or `rl` is not installed.
        InvalidSetup: A seed is given twice, or a run of another training is in a folder.
        DatasetError: The disk fails.
        RcsError: There is no such cluster, or a seed has ended several processes.
    """
    if not seeds or len(set(seeds)) < len(seeds):
        raise InvalidSetup(f"The seeds are {list(seeds)}; valid is one or more, all different.")
    folder = Path(out).absolute()
    sign = folder / f".rcs-{secrets.token_hex(8)}"
    training = replace(training, torch_threads=training.torch_threads or cpus)
    with disk_errors("train", folder):
        folder.mkdir(parents=True, exist_ok=True)
        sign.touch()
    gpus = 1 if training.device.startswith("cuda") else 0
    try:
        work = _Work(training, folder, sign, cpus, videos)
        with RayPool(work, len(seeds) if ray == LOCAL else 0, ray, cpus=cpus, gpus=gpus) as pool:
            for trained in pool.map(iter(seeds)):
                if not isinstance(trained, Trained):
                    trained, files = trained
                    with disk_errors("write a run", folder):
                        write_files(files, folder)
                yield replace(trained, run=run_of(folder, trained.seed))
    finally:
        sign.unlink(missing_ok=True)


class _Trainer:
    """Trains with one seed after the other: one process."""

    def __init__(self, training: Training, folder: Path, cpus: int, videos: bool) -> None:
        self._training, self._folder, self._cpus, self._videos = training, folder, cpus, videos

    def attempt(self, number: int) -> Trained:
        """Train with a seed."""
        progress, run = Progress(), run_of(self._folder, number)
        run.parent.mkdir(parents=True, exist_ok=True)
        training = replace(self._training, seed=number)
        for _ in train(training, run, progress, threads=self._cpus, videos=self._videos):
            pass
        return Trained(seed=number, run=run, steps=progress.steps, seconds=progress.seconds)

    def close(self) -> None:
        """Do nothing: a training closes what it has."""


@dataclass(frozen=True)
class _Work:
    """Makes the worker in its process; sent to it once."""

    training: Training
    folder: Path
    sign: Path
    """A file in the folder: a machine that sees it sees the folder."""
    cpus: int
    videos: bool

    def __call__(self) -> _Trainer | FileWorker:
        if self.sign.exists():
            return self._worker(self.folder)
        return FileWorker(self._worker)

    def _worker(self, folder: Path) -> _Trainer:
        return _Trainer(self.training, folder, self.cpus, self.videos)
