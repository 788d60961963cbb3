"""Kill recordings and edits by SIGKILL at random times and check the results.

A fifth of the trials each kills

- a collection in one process that notes, in memory shared with this program, how many rows it has recorded: there the
  loss is exact;
- the whole process tree of `rcs collect` with two workers;
- a program that deletes, keeps, trims, relabels, resamples, with --cameras resizes, merges, undoes and prunes;
- a program that exports to LeRobot's format and imports that without end;
- a program that pulls such an export without end, from a stand-in of the Hub on this machine (needs huggingface_hub).

After every kill the finished episodes are checked by hash and `recover` brings back the open ones; after an edit the
dataset must be as it was before or after it, and undo must lead back to what was recorded; a conversion's result is
complete or absent; of a pull, each file is, and another one completes it. A check lists all leftovers, and a repair
removes them.

Prints one JSON object, also when it is ended early. `lossless` counts the kills after which no finished episode was
missing or changed, no edit was half done and the check passed; `lost_rows_max` and `lost_s_max` are what the open
episode lost.
"""

from __future__ import annotations

import importlib.util
import json
import mmap
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import tyro
from rcs_data import Dataset, check, convert, edit, recover
from rcs_data.check.repair import repair
from rcs_data.convert.lerobot.hub import pull
from rcs_data.edit.rate import kept_rows
from rich.console import Console
from rich.progress import track

from rcs.envs.observer import Observer, Transition
from rcs.envs.setup import Setup
from rcs.errors import DatasetError
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.setups.make import make

FPS = 30.0
PATIENCE = 600.0
"""How long a program may take to be at work, or to be gone, on a busy machine [s]; longer is a hang."""
COUNTER = struct.Struct("<qq")
"""Number of the episode that is open and rows recorded of it."""
REPO = "me/set"
KINDS = ("record", "workers", "edit", "convert", "pull")


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    trials: int = 100
    """Kills."""
    seed: int = 0
    """Random seed of the times."""
    cameras: bool = False
    """Record two cameras."""
    child: tuple[str, str] | None = None
    """Used by the program itself: the kind of work to do without end, and its folder."""


@dataclass
class Totals:
    """Counts over all trials."""

    lossless: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    """Kills after which nothing was lost but the end of the open episode, by kind."""
    kills: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    """All kills."""
    finished: int = 0
    """Episodes that were finished before the kill."""
    damaged: int = 0
    """Finished episodes that were changed or missing."""
    recovered: int = 0
    """Recovered open episodes."""
    failed_checks: int = 0
    """Datasets that did not pass the check after `recover`."""
    half_edits: int = 0
    """Datasets that were neither as before the edit nor as after it, or whose edit could not be undone."""
    left: int = 0
    """Trials after which something was left that no check names or no repair removes."""
    lost: list[int] = field(default_factory=list[int])
    """Rows that open episodes lost, if known exactly."""


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


def edit_without_end(folder: Path) -> None:
    """Edit in random order, each time undo, then prune, merge, and so on, until killed."""
    dataset, merged = Dataset.open(folder), folder.with_suffix(".merged")
    ids = [episode.id for episode in dataset.episodes]
    edits: list[Callable[[], object]] = [
        lambda: edit.delete(folder, ids[:2]),
        lambda: edit.keep(folder, ids[2:]),
        lambda: edit.trim(folder, ids[0], first=3, last=20),
        lambda: edit.relabel(folder, "push"),
        lambda: edit.resample(folder, FPS / 2),
        *([lambda: edit.resize(folder, (32, 32))] if dataset.info.has_images else []),
    ]
    folder.with_suffix(".ready").touch()
    while True:
        for change in random.sample(edits, len(edits)):
            change()
            edit.undo(folder)
        edit.prune(folder)
        shutil.rmtree(merged, ignore_errors=True)
        edit.merge([folder, folder], merged)


def convert_without_end(folder: Path) -> None:
    """Export and import until killed."""
    folder.with_suffix(".ready").touch()
    while True:
        exported, imported = folder.with_suffix(".lerobot"), folder.with_suffix(".imported")
        for made in (exported, imported):
            shutil.rmtree(made, ignore_errors=True)
        convert.export_lerobot(Dataset.open(folder), exported)
        convert.import_lerobot(exported, imported)


def pull_without_end(folder: Path) -> None:
    """Pull until killed."""
    while True:
        pull(REPO, folder)
        folder.with_suffix(".ready").touch()
        shutil.rmtree(folder.rename(folder.with_suffix(".gone")))


def main(options: Options) -> None:
    """Kill, look, print."""
    setup = Setup(cameras=("wrist", "side") if options.cameras else ())
    if options.child is not None:
        work, folder = options.child
        works = {"edit": edit_without_end, "convert": convert_without_end, "pull": pull_without_end}
        works.get(work, lambda path: collect_and_count(path, setup))(Path(folder))
        return
    if importlib.util.find_spec("huggingface_hub") is None:
        raise SystemExit("The kills of pulls need huggingface_hub: pip install 'rcs-data[hub]'.")
    totals = Totals()
    try:
        kill_in_turns(options, setup, totals)
    finally:
        print(json.dumps(summary(totals)))


def kill_in_turns(options: Options, setup: Setup, totals: Totals) -> None:
    """Kill each kind of program in turn and count what is found."""
    rng = random.Random(options.seed)
    with tempfile.TemporaryDirectory(prefix="rcs-kill-") as root:
        source = Path(root) / "source"
        list(collect(Collection(setup=setup, out=source, episodes=4), Progress()))
        pushed = serve_export(source)
        for trial in track(range(options.trials), "Killing", console=Console(stderr=True)):
            folder = Path(root) / f"trial {trial}"
            kind = KINDS[trial % len(KINDS)]
            if kind == "edit":
                is_lossless = kill_edits(folder, source, rng, totals)
            elif kind == "convert":
                is_lossless = kill_conversions(folder, source, rng, totals)
            elif kind == "pull":
                is_lossless = kill_pulls(folder, pushed, rng)
            else:
                is_lossless = kill_recording(folder, rng, options.cameras, kind == "record", totals)
            totals.kills[kind] += 1
            totals.lossless[kind] += is_lossless
            for left in Path(root).glob(f"trial {trial}*"):
                shutil.rmtree(left) if left.is_dir() else left.unlink()


def summary(totals: Totals) -> dict[str, object]:
    """Return the counts of all trials as they are printed."""
    lost = max(totals.lost, default=0)
    return {
        "benchmark": "kill",
        "trials": sum(totals.kills.values()),
        "lossless": sum(totals.lossless.values()),
        "lossless_by_kind": {kind: f"{totals.lossless[kind]} of {totals.kills[kind]}" for kind in totals.kills},
        "finished_episodes": totals.finished,
        "damaged": totals.damaged,
        "half_edits": totals.half_edits,
        "left_behind": totals.left,
        "recovered_episodes": totals.recovered,
        "checks_failed_after_recover": totals.failed_checks,
        "exact_losses": len(totals.lost),
        "lost_rows_max": lost,
        "lost_s_max": round(lost / FPS, 3),
    }


def kill_after(command: list[str], is_under_way: Callable[[], bool], seconds: float) -> None:
    """Start a program, wait until it is at work and a while longer, and kill it with all its children."""
    process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    deadline = time.monotonic() + PATIENCE
    while not is_under_way():
        assert process.poll() is None, process.stderr.read().decode() if process.stderr else ""
        assert time.monotonic() < deadline, f"{command} did not start"
        time.sleep(0.01)
    time.sleep(seconds)
    assert process.poll() is None, process.stderr.read().decode() if process.stderr else ""
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def recover_after_workers(folder: Path) -> None:
    """Recover as soon as the last killed worker is gone; on a busy machine that takes longer than the parent."""
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            recover(folder)
            return
        except DatasetError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.02)


def kill_recording(folder: Path, rng: random.Random, has_cameras: bool, is_counted: bool, totals: Totals) -> bool:
    """Kill a collection, look at what is left, and return whether all that was finished is there as it was."""
    counter = folder.with_suffix(".rows")
    counter.write_bytes(COUNTER.pack(-1, 0))
    cameras = ["wrist", "side"] if has_cameras else ["none"]
    if is_counted:
        command = [sys.executable, __file__, "--child", "record", str(folder), *(["--cameras"] if has_cameras else [])]
    else:
        arguments = ["collect", "PickCuboid", "--episodes", "10000", "--workers", "2", "--out", str(folder)]
        command = [sys.executable, "-c", "from rcs.cli.main import main; main()", *arguments, "--cameras", *cameras]

    def is_under_way() -> bool:
        if is_counted:  # from the second episode on
            return COUNTER.unpack(counter.read_bytes())[0] >= 0
        return any((folder / "open").glob("*"))

    kill_after(command, is_under_way, rng.uniform(0.0, 1.5))
    episode, rows = COUNTER.unpack(counter.read_bytes())
    finished = {record.id for record in Dataset.open(folder).episodes}
    # The first episode was made before counting began, so the counter is one behind.
    expected = {f"{number:06d}" for number in range(episode + 1)} if is_counted else set[str]()
    damaged = {finding.episode for finding in check(folder).damage} & finished | (expected - finished)
    totals.finished += len(finished | expected)
    totals.damaged += len(damaged)
    recover_after_workers(folder)
    after = Dataset.open(folder)
    totals.recovered += len(after) - len(finished)
    is_ok = check(folder).is_ok
    totals.failed_checks += not is_ok
    if is_counted:
        kept = {record.id: record.length for record in after.episodes}.get(f"{episode + 1:06d}", 0)
        totals.lost.append(max(rows - kept, 0))
    return is_ok and not damaged


def kill_conversions(folder: Path, source: Path, rng: random.Random, totals: Totals) -> bool:
    """Kill a program that converts; return whether the source is as it was, and every result whole or not there."""
    shutil.copytree(source, folder)
    command = [sys.executable, __file__, "--child", "convert", str(folder)]
    kill_after(command, folder.with_suffix(".ready").exists, rng.uniform(0.0, 1.0))
    imported = folder.with_suffix(".imported")
    is_ok = check(folder).is_ok
    if imported.exists():  # the program may just have been removing it
        is_ok &= not (imported / "episodes.jsonl").exists() or check(imported).is_ok or not any(imported.iterdir())
        shutil.rmtree(imported)
    is_ok &= is_clean(folder, [folder.with_suffix(suffix) for suffix in (".lerobot", ".imported")], totals)
    totals.failed_checks += not is_ok
    return is_ok


def serve_export(source: Path) -> dict[str, bytes]:
    """Export a dataset, serve it from here on as the Hub would, and return its files by name."""
    export = source.with_suffix(".lerobot")
    convert.export_lerobot(Dataset.open(source), export)
    files = {str(path.relative_to(export)): path.read_bytes() for path in export.rglob("*") if path.is_file()}
    tests = Path(__file__).parents[1] / "packages/rcs-data/tests/convert/lerobot/test_hub.py"
    spec = importlib.util.spec_from_file_location("test_hub", tests)
    assert spec is not None and spec.loader is not None
    spec.loader.exec_module(stand_in := importlib.util.module_from_spec(spec))
    hub = stand_in.Hub()
    hub.repos[REPO] = files
    hub.handle_error = lambda *_: None  # those whom it answers are killed
    threading.Thread(target=hub.serve_forever, name="hub", daemon=True).start()
    # Before huggingface_hub is imported.
    os.environ |= {"HF_ENDPOINT": f"http://127.0.0.1:{hub.server_port}", "HF_HUB_DISABLE_PROGRESS_BARS": "1"}
    return files


def kill_pulls(folder: Path, pushed: dict[str, bytes], rng: random.Random) -> bool:
    """Kill a program that pulls; return whether each file is whole or not there, and another pull gets the rest."""
    command = [sys.executable, __file__, "--child", "pull", str(folder)]
    kill_after(command, folder.with_suffix(".ready").exists, rng.uniform(0.0, 0.5))
    is_whole = all((folder / name).read_bytes() == data for name, data in pushed.items() if (folder / name).exists())
    pull(REPO, folder)
    return is_whole and all((folder / name).read_bytes() == data for name, data in pushed.items())


def is_clean(folder: Path, results: list[Path], totals: Totals) -> bool:
    """Return True if checks name all that is left beside some results, and repairs remove it."""
    hidden = {path.name for path in folder.parent.iterdir() if path.name.startswith(f".{folder.name}")}
    named: set[str] = set()
    for result in (folder, *results):
        with suppress(DatasetError):  # there is nothing of that name
            named |= {finding.file for finding in check(result).findings if finding.kind == "left_over"}
        with suppress(DatasetError):
            repair(result)
    left = {path.name for path in folder.parent.iterdir() if path.name.startswith(f".{folder.name}")}
    is_named = all(name.removesuffix(".lock") in named for name in hidden)
    totals.left += bool(left) or not is_named
    return not left and is_named


def seen(folder: Path) -> tuple[str, list[str]]:
    """Return the numbers of a dataset and its instructions."""
    dataset = Dataset.open(folder)
    return dataset.digest(), [episode.instruction for episode in dataset.episodes]


def kill_edits(folder: Path, source: Path, rng: random.Random, totals: Totals) -> bool:
    """Kill a program that edits, look at what is left, and return whether each edit is there or not, and whole."""
    shutil.copytree(source, folder)
    recorded = Dataset.open(source)
    ids = [episode.id for episode in recorded.episodes]
    command = [sys.executable, __file__, "--child", "edit", str(folder)]
    kill_after(command, folder.with_suffix(".ready").exists, rng.uniform(0.0, 0.5))
    after = Dataset.open(folder)
    found = [(episode.id, episode.length) for episode in after.episodes]
    whole = [(episode.id, episode.length) for episode in recorded.episodes]
    resampled = [(name, len(kept_rows(length, 2))) for name, length in whole]
    is_edit = found in (whole, whole[2:], [(ids[0], 18), *whole[1:]], resampled)
    is_edit &= len({episode.instruction for episode in after}) == 1
    damaged = {finding.episode for finding in check(folder).damage}
    merged = folder.with_suffix(".merged")
    if (merged / "dataset.json").exists():
        is_edit &= len(Dataset.open(merged)) == 2 * len(ids) and check(merged).is_ok
    recover(folder)
    is_ok = check(folder).is_ok
    if seen(folder) != seen(source):
        edit.undo(folder)
    is_edit &= seen(folder) == seen(source)
    totals.finished += len(ids)
    totals.damaged += len(damaged)
    totals.failed_checks += not is_ok
    totals.half_edits += not is_edit
    return is_ok and is_edit and not damaged and is_clean(folder, [merged], totals)


if __name__ == "__main__":
    main(tyro.cli(Options))
