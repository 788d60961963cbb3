"""Kill a training with SIGKILL at random moments, let it go on each time, and compare it with one that was not.

    python tests/rl/kill_training.py --trials 20 --algorithm ppo

Prints one JSON object: kills, those of them while it learned, saved or evaluated, checkpoints that were there before a
kill and not after it, steps at the end, whether the figures of the curve are those of the unbroken run, each step once,
and whether the weights are, bit for bit.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

SMALL = [
    "--copies", "2", "--episodes", "2", "--max-episode-steps", "8", "--threads", "1", "--torch-threads", "1",
    "--frequency", "30", "--control", "joints", "--no-video",
]  # fmt: skip

EVERY = 60
"""Steps between two checkpoints; an update of the recipe has some more."""


def command(out: Path, algorithm: str, steps: int) -> list[str]:
    """Return the command that trains into a folder."""
    every = ["--evaluate-every", str(8 * EVERY), "--checkpoint-every", str(EVERY)]
    words = ["train", "PickCuboid", "--algorithm", algorithm, "--out", str(out), "--steps", str(steps), *every, *SMALL]
    return [sys.executable, "-c", "from rcs.cli.main import main; main()", *words]


def newest(out: Path) -> int:
    """Return the steps of the newest checkpoint; -1 for none."""
    from rcs.rl.checkpoint import checkpoints_of

    return max((int(place.name) for place in checkpoints_of(out)), default=-1)


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
    parser.add_argument("--algorithm", default="ppo")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    options = parser.parse_args()
    steps = 480 * (options.trials + 2)
    draw = random.Random(options.seed)
    lost, kills, at_work = 0, 0, 0
    with tempfile.TemporaryDirectory(prefix="rcs-kill-") as folder:
        whole, out = Path(folder) / "whole", Path(folder) / "killed"
        subprocess.run(command(whole, options.algorithm, steps), check=True, stdout=subprocess.DEVNULL)
        rows = [json.loads(line)["seconds"] for line in (whole / "metrics.jsonl").read_text().splitlines()]
        a_while = 3.0 * rows[-1] * EVERY / steps  # of learning: about three updates with their checkpoints
        while kills < options.trials:
            before = newest(out)
            process = subprocess.Popen(
                command(out, options.algorithm, steps), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
            )
            if kills % 5 == 4:  # before it is at work: while it starts, reads a checkpoint, removes what is too much
                time.sleep(draw.uniform(0.0, 6.0))
            else:
                while newest(out) <= before and process.poll() is None:
                    time.sleep(0.002)
                time.sleep(draw.uniform(0.0, a_while))
                at_work += process.poll() is None
            if process.poll() is not None:
                assert process.returncode == 0, process.stderr.read() if process.stderr else ""
                break  # it was faster than the kills
            process.kill()
            process.wait()
            kills += 1
            # Older ones that were not evaluated go as newer ones come; the newest before must be there, or a newer one.
            lost += newest(out) < before
            print(f"kill {kills}: step {before} -> {newest(out)} of {steps}", file=sys.stderr)
        subprocess.run(command(out, options.algorithm, steps), check=True, stdout=subprocess.DEVNULL)
        (weights, curve), (own_weights, own_curve) = result(whole), result(out)
        told = {
            "benchmark": "kill_training",
            "algorithm": options.algorithm,
            "kills": kills,
            "kills_at_work": at_work,
            "lost_checkpoints": lost,
            "steps": [newest(whole), newest(out)],
            "same_curve": curve == own_curve,
            "same_weights": weights.keys() == own_weights.keys()
            and all(bool((weights[name] == own_weights[name]).all()) for name in weights),
        }
    print(json.dumps(told))


if __name__ == "__main__":
    main()
