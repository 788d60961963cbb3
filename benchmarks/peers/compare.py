"""Compare the speed of other simulators on a similar scene with PickCuboid, in turns on the same two cores.

Each runs in an environment of its own (build/peers, made when missing: 2.5 GB), two seconds at a time, several rounds.
The simulations differ: control periods are 20 to 50 ms, physics steps 2 or 5 ms, and models and contacts differ.
Compare the simulated seconds per second, considering the physics step. Actions are random.

Prints a table, and one JSON object: per program `simulated_s_per_s`, `steps_per_s`, `physics_hz`, medians over rounds.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

HERE = Path(__file__).parent
PLACE = HERE.parents[1] / "build" / "peers"
PROGRAMS = {
    "RCS PickCuboid FR3": (None, "rcs_pick.py", (0, 84)),
    "EnvPool PandaPickCube": ("envpool", "envpool_pick.py", (0,)),
    "Gymnasium-Robotics FetchPickAndPlace": ("gymnasium-robotics", "fetch_pick.py", (0, 84)),
    "robosuite Lift": ("robosuite", "robosuite_lift.py", (0, 84)),
}
"""Environment, program, and image sizes of a camera [px], 0 for none, by name."""


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    rounds: int = 3
    """Rounds, in each of which every program runs once."""
    cores: str = "0,1"
    """Cores that all of them run on."""


def main(options: Options) -> None:
    """Measure and print."""
    console = Console(stderr=True)
    pythons = {name: python_of(name, console) for name in dict.fromkeys(who for who, _, _ in PROGRAMS.values())}
    turns = [
        (label, pythons[who], program, size)
        for _ in range(options.rounds)
        for label, (who, program, sizes) in PROGRAMS.items()
        for size in sizes
    ]
    found: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for label, python, program, size in track(turns, "Measuring", console=console):
        answer = run(python, program, size, options.cores)
        if answer is None:
            console.print(f"{label} with {size} px did not run")
        else:
            found.setdefault((label, size), []).append(answer)
    table = Table("", "camera [px]", "copies", "physics [Hz]", "control [Hz]", "steps/s", "simulated s/s")
    figures: list[dict[str, Any]] = []
    for (label, size), answers in found.items():
        rates = {key: median(one[key] for one in answers) for key in ("steps_per_s", "simulated_s_per_s")}
        last = answers[-1]
        control, physics = round(last["control_hz"], 2), round(last["physics_hz"])
        figures.append({"name": label, "pixels": size, "physics_hz": physics, "control_hz": control, **rates})
        numbers = (last["copies"], physics, f"{control:g}", f"{rates['steps_per_s']:.0f}")
        table.add_row(label, str(size or "none"), *map(str, numbers), f"{rates['simulated_s_per_s']:.1f}")
    console.print(table)
    print(json.dumps({"benchmark": "peers", "rounds": options.rounds, "results": figures}))


def python_of(name: str | None, console: Console) -> Path:
    """Return the Python of an environment, creating it if necessary."""
    if name is None:
        return Path(sys.executable)
    python = PLACE / name / "bin" / "python"
    stamp = PLACE / name / ".stamp"
    if not stamp.exists():
        console.print(f"Installing {name} into {PLACE / name}")
        venv.create(PLACE / name, with_pip=True, clear=True)
        wanted = HERE / f"requirements-{name}.txt"
        subprocess.run([python, "-m", "pip", "-qq", "--disable-pip-version-check", "install", "-r", wanted], check=True)
        stamp.touch()
    return python


def run(python: Path, program: str, size: int, cores: str) -> dict[str, Any] | None:
    """Return the output of a program; None if it failed."""
    command = ["taskset", "-c", cores, str(python), str(HERE / program), str(size)]
    environment = {**os.environ, "MUJOCO_GL": "egl", "OMP_NUM_THREADS": "1"}
    answer = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300, env=environment)
    lines = [line for line in answer.stdout.splitlines() if line.startswith("{")]
    if not lines:
        print(answer.stderr[-2000:], file=sys.stderr)
    return json.loads(lines[-1]) if lines else None


if __name__ == "__main__":
    main(tyro.cli(Options))
