"""Damages small datasets and uses them: `python tests/fuzz/datasets.py --trials 5000 --seed 1`.

Whatever is in its files, a dataset is read, or refused with an error of this library. A finding is any other error, an
exit code that no command has, a write outside of the dataset and its output, more than 500 MB of memory, or no end.
Trials run in child processes, for a library that a file crashes takes its process with it. The last line is JSON.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import logging
import os
import queue
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress

MOST_MEMORY_MB = 500
KEPT_MB = 240
"""Memory that a child may keep from trial to trial; giving back more often would cost more than the trials."""
TIMEOUT_S = 30.0
# Beyond this a child gets no memory, so that a bomb ends a trial and not the machine.
_ADDRESS_SPACE = 6 << 30


def main() -> int:
    """Run the trials and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", type=int, help="one trial, in this process, with its traceback")
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.serve is not None:
        return serve(given.serve)
    with tempfile.TemporaryDirectory(prefix="rcs-fuzz-") as folder:
        templates = Path(folder) / "templates"
        _make_templates(templates)
        if given.only is not None:
            told = trial(given.only, given.seed, templates, Path(folder) / "work")
            print(json.dumps(told, indent=1))
            return 1 if told["findings"] else 0
        result = fuzz(given.trials, given.seed, given.jobs, templates)
    print(json.dumps(result))
    return 1 if result["findings"] else 0


def fuzz(trials: int, seed: int, jobs: int, templates: Path) -> dict[str, Any]:
    """Run trials in child processes; return how many there were and what each finding was, the first of a kind."""
    numbers: queue.SimpleQueue[int] = queue.SimpleQueue()
    for number in range(trials):
        numbers.put(number)
    results: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threads = [threading.Thread(target=_supervise, args=(numbers, seed, templates, results)) for _ in range(jobs)]
    started = time.monotonic()
    kinds: Counter[str] = Counter()
    firsts: dict[str, dict[str, Any]] = {}
    peak = 0.0
    outcomes: Counter[str] = Counter()
    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("Fuzzing", total=trials)
        for thread in threads:
            thread.start()
        for _ in range(trials):
            told = results.get()
            peak = max(peak, told.get("memory_mb", 0.0))
            outcomes.update(told.get("outcomes", {}))
            for finding in told["findings"]:
                kinds[finding["kind"]] += 1
                firsts.setdefault(finding["kind"], {"trial": told["trial"], "damage": told.get("damage"), **finding})
            bar.update(task, advance=1, description=f"Fuzzing, {sum(kinds.values())} findings")
    for thread in threads:
        thread.join()
    return {
        "trials": trials,
        "seed": seed,
        "seconds": round(time.monotonic() - started, 1),
        "peak_memory_mb": round(peak),
        "outcomes": dict(outcomes),
        "findings": sum(kinds.values()),
        "kinds": [{"count": kinds[kind], **firsts[kind]} for kind in sorted(kinds, key=lambda k: -kinds[k])],
    }


def _supervise(numbers: Any, seed: int, templates: Path, results: Any) -> None:
    """Give trials to a child until there are none; start a new one when it dies or does not answer."""
    child: _Child | None = None
    while True:
        try:
            number = numbers.get_nowait()
        except queue.Empty:
            break
        if child is None:
            child = _Child(templates)
        told = child.ask({"trial": number, "seed": seed})
        results.put(told)
        if child.is_dead:
            child.close()
            child = None
    if child is not None:
        child.close()


class _Child:
    def __init__(self, templates: Path) -> None:
        command = [sys.executable, str(Path(__file__).resolve()), "--serve", str(templates)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()
        threading.Thread(target=self._drain, daemon=True).start()
        self._last_words = b""
        self.is_dead = False

    def ask(self, what: dict[str, Any]) -> dict[str, Any]:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(what).encode() + b"\n")
            self._process.stdin.flush()
        doing = "damage"
        deadline = time.monotonic() + TIMEOUT_S
        while True:
            try:
                line = self._lines.get(timeout=max(0.01, deadline - time.monotonic()))
            except queue.Empty:
                self.is_dead = True
                self._process.kill()
                return {"trial": what["trial"], "findings": [{"kind": f"hang in {doing.split()[0]}", "said": doing}]}
            if not line:
                self.is_dead = True
                code = self._process.wait()
                words = self._last_words.decode(errors="replace")[-600:]
                return {
                    "trial": what["trial"],
                    "findings": [{"kind": f"crash {code} in {doing.split()[0]}", "said": doing + words}],
                }
            told = json.loads(line)
            if "doing" in told:
                doing = told["doing"]
                continue
            return told

    def close(self) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line)
        self._lines.put(b"")

    def _drain(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self._last_words = (self._last_words + line)[-4000:]


def serve(templates: Path) -> int:
    """Be a child: answer each line with a line."""
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    logging.disable(logging.CRITICAL)
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    with tempfile.TemporaryDirectory(prefix="rcs-fuzz-work-") as folder:
        for line in sys.stdin:
            asked = json.loads(line)
            told = trial(asked["trial"], asked["seed"], templates, Path(folder) / "work", lambda doing: print(
                json.dumps({"doing": doing}), file=out))  # fmt: skip
            print(json.dumps(told), file=out)
    return 0


def trial(number: int, seed: int, templates: Path, work: Path, tell: Any = lambda doing: None) -> dict[str, Any]:
    """Damage a dataset and use it; return what was found."""
    from damage import KINDS, OURS, damage
    from exercises import chosen

    from rcs.errors import RcsError

    rng = random.Random(f"{seed} {number}")
    kind = rng.choice(KINDS)
    shutil.rmtree(work, ignore_errors=True)
    outside = work / "inner" / "outside"
    (outside / "folder" / "episodes").mkdir(parents=True)
    for file in (outside / "file", outside / "folder" / "file", outside / "folder" / "dataset.js"):
        file.write_bytes(b"mine")
    path = work / "inner" / "set"
    copy = shutil.copytree if (templates / kind).is_dir() else shutil.copy
    copy(templates / kind, path)
    said = [kind]
    with contextlib.suppress(OSError, RuntimeError, KeyError):  # two blows can hit the same file
        said += damage(path, kind, templates, rng)
    findings: list[dict[str, Any]] = []
    outcomes: dict[str, int] = {"done": 0, "refused": 0}
    before = _snapshot(work)
    most = 0.0
    for turn, (name, exercise) in enumerate(chosen(rng, is_ours=kind in OURS).items()):
        tell(f"{name} of {said}")
        _forget_peak()
        words = io.StringIO()
        try:
            with contextlib.redirect_stdout(words), contextlib.redirect_stderr(words):
                exercise(path, work / "inner" / "out" / str(turn))
            outcomes["refused" if words.getvalue().startswith("error:") else "done"] += 1
        except RcsError:
            outcomes["refused"] += 1
        except BaseException as err:  # this is what is looked for
            if isinstance(err, KeyboardInterrupt):
                raise
            findings.append({"kind": _kind(err), "exercise": name, "trace": traceback.format_exc()[-1800:]})
        memory = _peak_mb()
        most = max(most, memory)
        if memory > MOST_MEMORY_MB:
            findings.append({"kind": f"memory of {name}", "exercise": name, "mb": round(memory)})
        after = _snapshot(work)
        if after != before:
            changed = sorted({place for place, _ in before ^ after})[:5]
            findings.append({"kind": f"write outside by {name}", "exercise": name, "files": changed})
            before = after
    return {"trial": number, "damage": said, "findings": findings, "memory_mb": most, "outcomes": outcomes}


def _kind(error: BaseException) -> str:
    """Name an error by what it is and where it comes out of this library."""
    places = [f for f in traceback.extract_tb(error.__traceback__) if "/src/rcs/" in f.filename]
    place = f"{places[-1].filename.split('/src/rcs/')[-1]}:{places[-1].lineno}" if places else "?"
    return f"{type(error).__name__} at {place}"


def _snapshot(work: Path) -> set[tuple[str, str]]:
    """Return what is outside of the dataset and of the folder for output, with a hash of each file."""
    found: set[tuple[str, str]] = set()
    for folder, folders, files in os.walk(work):
        place = os.path.relpath(folder, work)
        if place == "inner":
            folders[:] = [name for name in folders if name not in ("set", "out")]
            files = [name for name in files if name != "set"]
        found.update((os.path.join(place, name), "folder") for name in folders)
        for name in files:
            data = Path(folder, name).read_bytes()
            found.add((os.path.join(place, name), hashlib.sha256(data).hexdigest()))
    return found


def _forget_peak() -> None:
    if _status_mb("VmRSS") > KEPT_MB:
        # What allocators keep of the trials before is not what this one needs: a command has a process of its own.
        import pyarrow as pa

        pa.default_memory_pool().release_unused()
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak_mb() -> float:
    return _status_mb("VmHWM")


def _status_mb(field: str) -> float:
    try:
        text = Path("/proc/self/status").read_text()
        return int(text.split(f"{field}:")[1].split()[0]) / 1024
    except (OSError, IndexError):
        return 0.0


def _make_templates(folder: Path) -> None:
    """In a child, for threads and memory that it takes are not those of the trials."""
    folder.mkdir(parents=True)
    code = "import sys, pathlib, damage; damage.make_templates(pathlib.Path(sys.argv[1]))"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parent)}
    subprocess.run([sys.executable, "-c", code, str(folder)], check=True, env=environment)


if __name__ == "__main__":
    sys.exit(main())
