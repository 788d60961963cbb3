"""Calls everything in the core, and worlds and environments, with right and wrong arguments: `--calls N --seed S`.

Whatever is not an exception of an expected kind is a finding: a process that ends or hangs, and any other exception.
Calls are made in a child process, in rounds of 200 that start from fresh objects; `--round R` repeats one and prints
its calls. The last line of output is JSON. Under sanitizers: `make test-sanitize FUZZ=300000`.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import mmap
import os
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
CALLS_PER_ROUND = 200
TEXT = 2000
"""Bytes in which a child says which call it makes."""
STARTING = "starting"
STARTING_TIME = 120.0
"""How long the imports of a child may take [s]; under sanitizers on a loaded machine it is some seconds."""


def expected_errors() -> tuple[type[BaseException], ...]:
    """Return what a call may raise; other RuntimeErrors are exceptions of C++ that nobody named."""
    from rcs.errors import RcsError

    return (RcsError, TypeError, ValueError, KeyError, IndexError, AttributeError, OverflowError)


class Progress:
    """The call that a child makes now, where its parent sees it when the child has died."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("r+b")
        self._map = mmap.mmap(self._file.fileno(), 8 + TEXT)

    def note(self, number: int, text: str) -> None:
        self._map[8 : 8 + TEXT] = text.encode("utf-8", "replace")[:TEXT].ljust(TEXT, b"\0")
        self._map[:8] = number.to_bytes(8, "little")

    def read(self) -> tuple[int, str]:
        return int.from_bytes(self._map[:8], "little"), self._map[8:].rstrip(b"\0").decode("utf-8", "replace")


def run_round(
    seed: int, number: int, shared: Any, targets: list[Any], note: Callable[[int, str], None]
) -> list[dict[str, Any]]:
    """Make the calls of a round and return its findings."""
    from tests.fuzz.stage import Stage

    expected = expected_errors()
    stage = Stage(f"{seed}/{number}", shared, targets)
    findings: list[dict[str, Any]] = []

    def attempt(text: str, call: Callable[[], Any]) -> None:
        try:
            stage.keep(call())
        except expected:
            pass
        except BaseException as error:  # noqa: BLE001  finding these is the purpose
            findings.append({"round": number, "kind": type(error).__name__, "call": text, "message": str(error)[:300]})

    for i in range(CALLS_PER_ROUND):
        text, call = stage.next_call()
        first = number * CALLS_PER_ROUND + i
        stage.describe = lambda inner, first=first, text=text: note(first, f"{text}; {inner}")
        if stage.r.random() < 0.01:
            other_text, other = stage.next_call()
            note(first, f"{text} beside {other_text}")
            thread = threading.Thread(target=attempt, args=(other_text, other), daemon=True)
            thread.start()
            attempt(text, call)
            thread.join()
        else:
            note(first, text)
            attempt(text, call)
    note(number * CALLS_PER_ROUND, "closing")
    attempt("closing", stage.close)
    return findings


def _fail() -> None:
    raise RuntimeError("planted")


PLANTED: dict[str, Callable[[], Any]] = {"end": os.abort, "hang": lambda: time.sleep(1e6), "error": _fail}
"""Calls that are findings, to test that they are found."""


def child(seed: int, first: int, last: int, progress: Path, planted: str) -> None:
    """Run rounds; a line of JSON for each finding, the names of what was called at the end."""
    from tests.fuzz.stage import Shared
    from tests.fuzz.targets import Target, targets_of_core, targets_of_python

    warnings.simplefilter("ignore")
    faulthandler.enable()
    targets = targets_of_core() + targets_of_python()
    if planted:
        targets = [Target(f"planted_{planted}", PLANTED[planted], None, ((),))]
    shared, notes = Shared(), Progress(progress)
    seen: Counter[str] = Counter()

    def note(number: int, text: str) -> None:
        seen[text.split("(")[0]] += 1
        notes.note(number, text)

    for number in range(first, last):
        for finding in run_round(seed, number, shared, targets, note):
            sys.stdout.write(json.dumps(finding) + "\n")
        sys.stdout.flush()
    sys.stdout.write(json.dumps({"seen": sorted(seen)}) + "\n")
    sys.stdout.flush()
    os._exit(0)  # what is left over is the next round's business, and the end of Python is another test's


def fuzz(
    calls: int,
    seed: int,
    *,
    timeout: float = 20.0,
    planted: str = "",
    show: Callable[[int, int], None] = lambda done, findings: None,
) -> dict[str, Any]:
    """Make so many calls and return what was found.

    Args:
        calls: How many, rounded up to whole rounds.
        seed: Seed from which calls and their arguments follow.
        timeout: How long one call may take [s].
        planted: A finding to make, of `PLANTED`.
        show: Called with the number of calls and findings so far.
    """
    rounds = -(-calls // CALLS_PER_ROUND)
    first, findings, seen = 0, [], set[str]()
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        progress = Path(folder, "progress")
        progress.write_bytes(bytes(8 + TEXT))
        notes = Progress(progress)
        while first < rounds:
            notes.note(first * CALLS_PER_ROUND, STARTING)
            out, err = Path(folder, "out"), Path(folder, "err")
            command = [
                sys.executable,
                str(Path(__file__)),
                "--seed",
                str(seed),
                "--child",
                str(first),
                str(rounds),
                str(progress),
                planted,
            ]
            with out.open("wb") as stdout, err.open("wb") as stderr:
                process = subprocess.Popen(
                    command, stdout=stdout, stderr=stderr, cwd=folder
                )  # where MuJoCo writes its log
                kind = _watch(process, notes, timeout, lambda number: show(number, len(findings)))
            for line in out.read_text().splitlines():
                value = json.loads(line)
                if "seen" in value:
                    seen.update(value["seen"])
                else:
                    findings.append(value)
            if kind is None:
                break
            number, text = notes.read()
            first = number // CALLS_PER_ROUND + 1
            tail = err.read_text(errors="replace")[-3000:]
            findings.append({"round": first - 1, "kind": kind, "call": text, "message": tail})
    seconds = time.monotonic() - begin
    distinct: dict[tuple[str, str], dict[str, Any]] = {}
    for finding in findings:
        # The last words of a process differ from time to time.
        message = "" if finding["kind"].startswith("end") else finding["message"][:60]
        key = (finding["kind"], finding["call"].split("(")[0] + message)
        distinct.setdefault(key, {**finding, "times": 0})["times"] += 1
    made = rounds * CALLS_PER_ROUND
    return {
        "fuzz": "core",
        "seed": seed,
        "calls": made,
        "seconds": round(seconds, 1),
        "calls_per_second": round(made / seconds),
        "seen": sorted(seen),
        "findings": list(distinct.values()),
    }


def _watch(
    process: subprocess.Popen[bytes], notes: Progress, timeout: float, show: Callable[[int], None]
) -> str | None:
    """Wait for a child: None when it came to its end, else how it ended."""
    last, since = (-1, ""), time.monotonic()
    while True:
        try:
            code = process.wait(0.2)
            return None if code == 0 else f"end with {code}"
        except subprocess.TimeoutExpired:
            pass
        number, text = notes.read()
        show(number)
        limit = STARTING_TIME if text == STARTING else timeout
        if (number, text) != last:
            last, since = (number, text), time.monotonic()
        elif time.monotonic() - since > limit:
            process.send_signal(6)  # for the traceback of faulthandler
            process.wait()
            return "hang"


def main() -> int:
    """Fuzz, show the progress and print one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=20_000, help="how many calls to make")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--timeout", type=float, default=30.0, help="how long one call may take [s]")
    parser.add_argument("--round", type=int, help="repeat this round in this process and print its calls")
    parser.add_argument("--child", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    sys.path.insert(0, str(ROOT))
    if options.child:
        child(options.seed, int(options.child[0]), int(options.child[1]), Path(options.child[2]), options.child[3])
    if options.round is not None:
        from tests.fuzz.stage import Shared
        from tests.fuzz.targets import targets_of_core, targets_of_python

        faulthandler.enable()
        targets = targets_of_core() + targets_of_python()
        findings = run_round(
            options.seed, options.round, Shared(), targets, lambda number, text: print(number, text, flush=True)
        )
        print(json.dumps(findings, indent=1))
        return 1 if findings else 0

    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bar(*columns) as bar:
        task = bar.add_task("fuzzing", total=options.calls)
        result = fuzz(
            options.calls,
            options.seed,
            timeout=options.timeout,
            show=lambda done, found: bar.update(task, completed=done, description=f"{found} findings"),
        )
    for finding in result["findings"]:
        print(f"{finding['kind']} (x{finding['times']}): {finding['call']}\n    {finding['message']}")
        print(f"    again: python tests/fuzz/fuzz_core.py --seed {options.seed} --round {finding['round']}")
    result["seen"] = len(result["seen"])
    print(json.dumps(result))
    return 1 if result["findings"] else 0


if __name__ == "__main__":
    sys.exit(main())
