"""Exercises that people do with a dataset: each may refuse with an error of this library, and may do nothing else."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

from rcs_data import Dataset, DatasetWriter, FrameAccess, Windows, check, recover
from rcs_data.check.repair import repair
from rcs_data.cli.check import CheckCommand, RecoverCommand
from rcs_data.cli.combine import MergeCommand, MixCommand, SplitCommand
from rcs_data.cli.convert import ExportCommand, ImportCommand
from rcs_data.cli.edit import DeleteCommand, HistoryCommand, KeepCommand, PruneCommand, RelabelCommand, UndoCommand
from rcs_data.cli.program import run
from rcs_data.cli.view import InfoCommand, ViewCommand
from rcs_data.view import write_report

from rcs.rollout.recorded_setup import physics_of

Exercise = Callable[[Path, Path], object]


def read(path: Path, out: Path) -> None:
    """Read all that an episode has."""
    for episode in Dataset.open(path):
        for feature in episode.info.features:
            episode.column(feature.key)
        _ = episode.success, episode.outcome, episode.timing, episode.source
        episode.sim_state()


def read_frames(path: Path, out: Path) -> None:
    """Read single images."""
    access = FrameAccess()
    for episode in Dataset.open(path):
        for feature in episode.info.features:
            if feature.is_image:
                access.frame(episode, feature.key, 0)


def table(path: Path, out: Path) -> None:
    """Read the numbers of all episodes at once."""
    for episode in Dataset.open(path):
        episode.steps()


def train(path: Path, out: Path) -> None:
    """Cut windows out of the episodes."""
    windows = Windows(Dataset.open(path), history=2, horizon=3)
    if len(windows):
        _ = windows[0]
    windows.statistics()


def resume(path: Path, out: Path) -> None:
    """Go on recording."""
    with DatasetWriter.open(path, Dataset.open(path).info, resume=True) as writer:
        writer.episode("new", seed=1).discard()


def look(path: Path, out: Path) -> None:
    """Ask for the setup, as a replay does."""
    physics_of(Dataset.open(path))


def command(make: Callable[[Path, Path], object]) -> Exercise:
    """Return a command as an exercise: it may end with 0, 1 or 2."""

    def exercise(path: Path, out: Path) -> None:
        code = run(make(path, out))
        assert code in (0, 1, 2), f"exit code {code}"

    return exercise


ALWAYS: dict[str, Exercise] = {
    "read": read,
    "check": lambda path, out: check(path, workers=1),
    "info": command(lambda path, out: InfoCommand(path=path)),
}
READING: dict[str, Exercise] = {
    "read_frames": read_frames,
    "table": table,
    "train": train,
    "look": look,
    "report": lambda path, out: write_report(path),
    "view": command(lambda path, out: ViewCommand(path=path)),
    "view_out": command(lambda path, out: ViewCommand(path=path, out=out)),
    "history": command(lambda path, out: HistoryCommand(path=path)),
    "check_json": command(lambda path, out: CheckCommand(path=path, json=True, depth="bytes")),
    "split": command(lambda path, out: SplitCommand(path=path, out=out)),
    "split_parts": command(lambda path, out: SplitCommand(path=path, out=out, parts=("a=0.5", "b=0.5"))),
    "merge": command(lambda path, out: MergeCommand(sources=(path, path), out=out)),
    "mix": command(lambda path, out: MixCommand(parts=(f"{path}:1", str(path)), out=out)),
    **{
        f"export_{name}": command(lambda path, out, name=name: ExportCommand(path=path, out=out, format=name))
        for name in ("lerobot-v3", "lerobot-v2.1", "gr00t", "rlds", "robomimic")
    },
}
CHANGING: dict[str, Exercise] = {
    "recover": lambda path, out: recover(path),
    "recover_command": command(lambda path, out: RecoverCommand(path=path)),
    "resume": resume,
    "repair": lambda path, out: repair(path, workers=1),
    "repair_command": command(lambda path, out: CheckCommand(path=path, repair=True, json=True)),
    "delete": command(lambda path, out: DeleteCommand(path=path, episodes=("000000",))),
    "keep": command(lambda path, out: KeepCommand(path=path, which="successful")),
    "relabel": command(lambda path, out: RelabelCommand(path=path, instruction="push")),
    "undo": command(lambda path, out: UndoCommand(path=path)),
    "prune": command(lambda path, out: PruneCommand(path=path)),
}
IMPORTING: dict[str, Exercise] = {
    "import": command(lambda path, out: ImportCommand(source=path, out=out)),
    "import_lerobot": command(lambda path, out: ImportCommand(source=path, out=out, format="lerobot")),
    "import_robomimic": command(lambda path, out: ImportCommand(source=path, out=out, format="robomimic")),
}


def chosen(rng: random.Random, *, is_ours: bool) -> dict[str, Exercise]:
    """Draw what is done with a dataset, in an order: what changes it comes last."""
    if not is_ours:
        return {"import": IMPORTING["import"], **dict([rng.choice(list(IMPORTING.items()))])}
    some = rng.sample(list(READING.items()), 3) + rng.sample(list(CHANGING.items()), 2)
    return {**ALWAYS, **dict(some), "read again": read}
