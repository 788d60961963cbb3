"""Kill collections at random moments with SIGKILL and see what is left.

Half of the trials kill the whole process tree of `rcs collect` with two workers. The other half kill a collection in
one process that notes, in memory shared with this program, how many rows it has recorded: there the loss is exact.
After every kill the finished episodes are checked by hash and `recover` brings back the open ones.

Prints one JSON object: `trials`, `damaged` (finished episodes that are not as they were written), `lost_rows_max` and
`lost_s_max` (of the open episode).
"""

from __future__ import annotations

import json
import mmap
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.progress import track

from rcs.data import Dataset, check, recover
from rcs.envs.observers import Observer, Transition
from rcs.envs.setup import Setup
from rcs.rollout.collect import Collection, Progress, collect
from rcs.setups.make import make

FPS = 30.0
COUNTER = struct.Struct("<qq")
"""Number of the episode that is open and rows recorded of it."""


@dataclass(kw_only=True)
class Options:
    """What to do."""

    trials: int = 100
    """Kills."""
    seed: int = 0
    """Of the moments."""
    cameras: bool = False
    """Record two cameras."""
    child: str = ""
    """Used by the program itself: collect into this folder and count rows."""


class RowCounter(Observer):
    """Notes, in memory that outlives the process, how many rows are recorded."""

    def __init__(self, memory: mmap.mmap) -> None:
        """Write into shared memory."""
        self._memory = memory
        self._episode = -1
        self._rows = 0

    def on_reset(self, first: Transition, seed: int | None) -> None:
        """Count the first row of the next episode."""
        self._episode += 1
        self._note(1)

    def on_step(self, transition: Transition) -> None:
        """Count a row."""
        self._note(self._rows + 1)

    def _note(self, rows: int) -> None:
        self._rows = rows
        self._memory[: COUNTER.size] = COUNTER.pack(self._episode, rows)


def collect_and_count(folder: Path, setup: Setup) -> None:
    """Collect in this process until killed."""
    with open(folder.with_suffix(".rows"), "r+b") as file:
        memory = mmap.mmap(file.fileno(), COUNTER.size)
    env = make(setup)
    made = collect(Collection(setup=setup, out=folder, episodes=10_000), Progress(), env)
    next(made)  # the recorder is added here; the counter comes after it and counts what it has taken
    env.add_observer(RowCounter(memory))
    for _ in made:
        pass


def main(options: Options) -> None:
    """Kill, look, print."""
    setup = Setup(cameras=("wrist", "side") if options.cameras else ())
    if options.child:
        collect_and_count(Path(options.child), setup)
        return
    rng = random.Random(options.seed)
    totals: dict[str, Any] = {
        "finished": 0,
        "damaged": 0,
        "recovered": 0,
        "lost": [],
        "unreadable": 0,
        "failed_checks": 0,
    }
    with tempfile.TemporaryDirectory(prefix="rcs-kill-") as root:
        for trial in track(range(options.trials), "Killing", console=Console(stderr=True)):
            one_trial(Path(root) / f"trial {trial}", rng, options.cameras, trial % 2 == 0, totals)
    lost = max(totals["lost"], default=0)
    print(
        json.dumps(
            {
                "benchmark": "kill",
                "trials": options.trials,
                "finished_episodes": totals["finished"],
                "damaged": totals["damaged"],
                "recovered_episodes": totals["recovered"],
                "checks_failed_after_recover": totals["failed_checks"],
                "exact_losses": len(totals["lost"]),
                "lost_rows_max": lost,
                "lost_s_max": round(lost / FPS, 3),
            }
        )
    )


def one_trial(folder: Path, rng: random.Random, has_cameras: bool, is_counted: bool, totals: dict[str, Any]) -> None:
    """Start a collection, kill it at a random moment, look at what is left."""
    counter = folder.with_suffix(".rows")
    counter.write_bytes(COUNTER.pack(-1, 0))
    cameras = ["wrist", "side"] if has_cameras else ["none"]
    if is_counted:
        command = [sys.executable, __file__, "--child", str(folder), *(["--cameras"] if has_cameras else [])]
    else:
        arguments = ["collect", "PickCuboid", "--episodes", "10000", "--workers", "2", "--out", str(folder)]
        command = [sys.executable, "-c", "from rcs.cli.main import main; main()", *arguments, "--cameras", *cameras]
    process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 60
    while not any((folder / "episodes").glob("*")):  # it collects
        assert process.poll() is None, process.stderr.read().decode() if process.stderr else ""
        assert time.monotonic() < deadline, "the collection did not start"
        time.sleep(0.01)
    time.sleep(rng.uniform(0.0, 1.5))
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    time.sleep(0.05)  # workers die with their parent, but not in the same instant
    episode, rows = COUNTER.unpack(counter.read_bytes())
    finished = {record.id for record in Dataset.open(folder).episodes}
    before = check(folder)
    totals["finished"] += len(finished)
    totals["damaged"] += len({finding.episode for finding in before.findings} & finished)
    recover(folder)
    after = Dataset.open(folder)
    totals["recovered"] += len(after) - len(finished)
    totals["failed_checks"] += not check(folder).is_ok
    if is_counted and episode >= 0:
        # The first episode was made before counting began, so the counter is one behind.
        name = f"{episode + 1:06d}"
        kept = {record.id: record.length for record in after.episodes}.get(name, 0)
        totals["lost"].append(max(rows - kept, 0))


if __name__ == "__main__":
    main(tyro.cli(Options))
