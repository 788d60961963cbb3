"""Kill evaluations by SIGKILL at random times, let them go on, and compare their ledgers with one that was not killed.

    python benchmarks/kill_evaluation.py [--trials 50] [--episodes 24] [--seed 0]

In turn, the victim is the evaluator, `rcs eval` with two workers; one of its workers; and the server of a policy that
`rcs run` evaluates. After each kill the same command goes on. When all episodes are there, and kills are left, another
evaluation begins.

Prints one JSON object: `kills`, by victim; `equal`, whether all rows, sorted by key, are those of evaluations without a
kill, but for times; `run_again`, how many episodes `rcs eval` began again because of its kills, each of which ended two
at most; `damaged`, lines that are damaged in the end.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Generator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rcs_data.ledger import Ledger, Row
from rcs_data.ledger.row import TIMES

from rcs.agents import PickExpert
from rcs.envs.spaces import Observation

RCS = [sys.executable, "-c", "from rcs.cli.main import main; main()"]
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SHORT = ["--max-episode-steps", "120"]
WORKERS = 2
BEGUN = "RCS_EPISODES_BEGUN"
"""Environment variable with the file that has a character per episode that was begun."""


class Counted(PickExpert):
    """The expert, which notes in a file that it begins an episode."""

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin an episode."""
        with Path(os.environ[BEGUN]).open("a") as file:
            file.write("1")
        super().reset(observation, info)


def main() -> None:
    """Run the benchmark and print its line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--episodes", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng, kills, damaged, again, is_equal, evaluations = random.Random(given.seed), Counter[str](), 0, 0, True, 0
    with tempfile.TemporaryDirectory() as folder:
        wanted: dict[str, set[Any]] = {}
        lasts: dict[str, float] = {}
        for verb in ("eval", "run"):
            began, whole = time.monotonic(), Path(folder, verb)
            finish(verb, whole, given.episodes)
            lasts[verb], wanted[verb] = time.monotonic() - began, rows_of(whole)
        while kills.total() < given.trials:
            verb = "run" if kills["server"] * 3 < kills.total() else "eval"
            out = Path(folder, f"killed-{evaluations}")
            evaluations += 1
            while kills.total() < given.trials and count(out) < given.episodes:
                victim = "server" if verb == "run" else min(("evaluator", "worker"), key=lambda name: kills[name])
                kills[victim] += killed(verb, out, given.episodes, victim, rng.uniform(0.0, lasts[verb]))
            finish(verb, out, given.episodes)
            is_equal &= rows_of(out) == wanted[verb]
            damaged += len(Ledger(out).damage)
            again += 0 if verb == "run" else out.with_suffix(".begun").stat().st_size - given.episodes
    line = {"kills": dict(kills), "equal": is_equal, "run_again": again, "damaged": damaged, "evaluations": evaluations}
    print(json.dumps({"benchmark": "kill_evaluation", "episodes": given.episodes, **line}))


def rows_of(folder: Path) -> set[tuple[Any, ...]]:
    """Return what the rows of a ledger say, besides times."""
    names = [name for name in Row.__struct_fields__ if name not in TIMES]
    return {tuple(getattr(row, name) for name in names) for row in Ledger(folder).rows.values()}


def count(folder: Path) -> int:
    """Return how many episodes are in a ledger."""
    return len(Ledger(folder).rows) if (folder / "ledger.jsonl").exists() else 0


def start(verb: str, out: Path, episodes: int, port: int, errors: Any = None) -> subprocess.Popen[bytes]:
    """Start an evaluation."""
    words = ["--episodes", str(episodes), "--out", str(out), *SHORT]
    if verb == "run":
        words = ["run", "--policy", f"vla://127.0.0.1:{port}", *words]
    else:
        words = ["eval", "PickCuboid", "--agent", "kill_evaluation:Counted", "--workers", str(WORKERS), *words]
    about = {**os.environ, BEGUN: str(out.with_suffix(".begun"))}
    here = Path(__file__).resolve().parent
    return subprocess.Popen([*RCS, *words], cwd=here, env=about, stdout=subprocess.DEVNULL, stderr=errors)


def serve(port: int) -> subprocess.Popen[bytes]:
    """Start the server of the policy, and wait until it is there."""
    words = [sys.executable, "-m", "vlagents.cli", "serve", "16_policy:policy"]
    server = subprocess.Popen([*words, "--port", str(port)], cwd=EXAMPLES, stdout=subprocess.DEVNULL, stderr=sys.stderr)
    while server.poll() is None:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 0.2):
            break
        time.sleep(0.05)
    return server


def free_port() -> int:
    """Return a port that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def finish(verb: str, out: Path, episodes: int) -> None:
    """Run an evaluation to its end."""
    with serving(verb) as (port, _):
        if start(verb, out, episodes, port).wait() != 0:
            sys.exit(f"rcs {verb} failed")


def killed(verb: str, out: Path, episodes: int, victim: str, after: float) -> bool:
    """Start an evaluation, kill something after a time [s], and wait for its end; return whether it was there."""
    with serving(verb) as (port, server):
        process = start(verb, out, episodes, port, subprocess.DEVNULL)
        try:
            with suppress(subprocess.TimeoutExpired):
                process.wait(after)
                return False
            if victim == "worker":
                while not (workers := workers_of(process.pid)) and process.poll() is None:
                    time.sleep(0.01)
                if not workers:
                    return False
                os.kill(random.Random(after).choice(workers), signal.SIGKILL)
            else:
                (server or process).kill()
            process.wait(120)
            return True
        finally:
            process.kill()
            process.wait()


@contextmanager
def serving(verb: str) -> Generator[tuple[int, subprocess.Popen[bytes] | None]]:
    """Yield the port of a policy and the process of its server, which is killed at the end; None for `rcs eval`."""
    port = free_port()
    server = serve(port) if verb == "run" else None
    try:
        yield port, server
    finally:
        if server is not None:
            server.kill()
            server.wait()


def workers_of(process: int) -> list[int]:
    """Return the worker processes of an evaluator."""
    found = []
    path = Path(f"/proc/{process}/task/{process}/children")
    for child in path.read_text().split() if path.exists() else ():
        with suppress(OSError):
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                found.append(int(child))
    return found


if __name__ == "__main__":
    main()
