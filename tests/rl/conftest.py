"""A training that takes a second: few short episodes, small networks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import rcs
from rcs.rl.training import Ppo, Training

SETUP = rcs.Setup(
    task="PickCuboid",
    max_episode_steps=7,
    observe=("privileged", "contacts"),
    collision_reaction=False,
    reward="dense",
    discount=0.95,
)
ALGORITHMS = {
    "ppo": Ppo(n_steps=10, batch_size=10, n_epochs=2, network=(8,)),
    "steady": Ppo(n_steps=10, batch_size=10, n_epochs=2, network=(8,), schedule="constant"),
}


@dataclass(frozen=True)
class Small:
    """Makes small trainings and runs them."""

    def training(self, name: str = "ppo", **changes: Any) -> Training:
        """Return a training by the name of its algorithm in `ALGORITHMS`."""
        usual: dict[str, Any] = {
            "setup": SETUP, "copies": 2, "steps": 160, "algorithm": ALGORITHMS[name],
            "evaluate_every": 60, "checkpoint_every": 20, "episodes": 3, "torch_threads": 1,
        }  # fmt: skip
        return Training(**{**usual, **changes})

    def run(self, training: Training, out: Path, updates: int | None = None) -> Any:
        """Train, to the end or until a kill after so many yields; return the progress."""
        from rcs.rl.train import TrainingProgress, train

        progress = TrainingProgress()
        running = train(training, out, progress, threads=1, videos=False)
        for number, _ in enumerate(running, 1):
            if number == updates:
                break
        running.close()
        return progress


@pytest.fixture
def small() -> Small:
    """Small trainings."""
    return Small()


@pytest.fixture
def weights() -> Callable[[Path], dict[str, Any]]:
    """Return a function that reads the weights of a run's newest checkpoint."""

    def read(run: Path) -> dict[str, Any]:
        from rcs.rl.checkpoint import checkpoints_of, open_checkpoint

        return {name: own.numpy() for name, own in open_checkpoint(checkpoints_of(run)[-1]).policy().items()}

    return read
