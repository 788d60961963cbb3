"""Kill a training with SIGKILL at random moments, let it go on each time, and compare it with one that was not.

    python tests/rl/kill_training.py --trials 20 --algo ppo

Prints one JSON object: kills, checkpoints that were there before a kill and not after it, steps at the end, whether the
figures of the curve are those of the unbroken run, each step once, and whether the weights are, bit for bit.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

SMALL = [
    "--copies", "2", "--episodes", "2", "--max-episode-steps", "8", "--threads", "1", "--torch-threads", "1",
    "--frequency", "30", "--control", "joints", "--video=False",
]  # fmt: skip


def command(out: Path, algo: str, steps: int) -> list[str]:
    """Return the command that trains into a folder."""
    every = ["--evaluate-every", str(steps // 4), "--checkpoint-every", str(steps // 20)]
    words = ["train", "PickCuboid", "--algo", algo, "--out", str(out), "--steps", str(steps), *every, *SMALL]
    words = [word for word in words if word != "--video=False"] + ["--no-video"]
    return [sys.executable, "-c", "from rcs.cli.main import main; main()", *words]


def checkpoints(out: Path) -> list[int]:
    """Return the steps of all checkpoints."""
    from rcs.rl.checkpoint import checkpoints_of

    return [int(place.name) for place in checkpoints_of(out)]


def result(out: Path) -> tuple[dict[str, Any], list[Any]]:
    """Return the weights of the newest checkpoint, and the curve without what depends on time."""
    from rcs.rl.checkpoint import checkpoints_of, open_checkpoint
    from rcs.rl.metrics import SPEED, read_metrics

    weights = open_checkpoint(checkpoints_of(out)[-1]).policy()
    curve = [
        (row.steps, {name: value for name, value in row.figures.items() if name != SPEED}) for row in read_metrics(out)
    ]
    return weights, curve


def main() -> None:
    """Train, kill, go on, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--algo", default="ppo")
    parser.add_argument("--steps", type=int, default=0, help="of the whole training; 0 for 160 per trial")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    options = parser.parse_args()
    steps = options.steps or 160 * max(options.trials, 4)
    draw = random.Random(options.seed)
    lost, kills = 0, 0
    with tempfile.TemporaryDirectory(prefix="rcs-kill-") as folder:
        whole, out = Path(folder) / "whole", Path(folder) / "killed"
        start = time.monotonic()
        subprocess.run(command(whole, options.algo, steps), check=True, stdout=subprocess.DEVNULL)
        learning = time.monotonic() - start
        while kills < options.trials:
            before = checkpoints(out)
            process = subprocess.Popen(
                command(out, options.algo, steps), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
            )
            # From the first moment, imports included, to somewhat more than the share of this trial.
            try:
                process.wait(draw.uniform(0.0, 4.0 + 2.0 * learning / options.trials))
                assert process.returncode == 0, process.stderr.read() if process.stderr else ""
                break  # it was faster than the kills
            except subprocess.TimeoutExpired:
                os.kill(process.pid, signal.SIGKILL)
                process.wait()
                kills += 1
            after = checkpoints(out)
            # Older ones that were not evaluated go as newer ones come; the newest before must be there, or a newer one.
            lost += bool(before) and max(after, default=-1) < max(before)
            print(f"kill {kills}: {before[-1:]} -> {after[-1:]} of {steps}", file=sys.stderr)
        subprocess.run(command(out, options.algo, steps), check=True, stdout=subprocess.DEVNULL)
        (weights, curve), (own_weights, own_curve) = result(whole), result(out)
        told = {
            "benchmark": "kill_training",
            "algorithm": options.algo,
            "kills": kills,
            "lost_checkpoints": lost,
            "steps": [checkpoints(whole)[-1], checkpoints(out)[-1]],
            "same_curve": curve == own_curve,
            "same_weights": weights.keys() == own_weights.keys()
            and all(bool((weights[name] == own_weights[name]).all()) for name in weights),
        }
    print(json.dumps(told))


if __name__ == "__main__":
    main()
