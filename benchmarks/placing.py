"""Count cuboids that a virtual FR3 picks, and sets down where the next episode begins, without a person.

    python benchmarks/placing.py [--episodes 200]

The collection of the paper (`placed_by="robot"`), over the wire of the arm and its hand. Where a cuboid lies, and
whether it was picked, is measured in the world of the virtual robot (`VirtualSupervisor`), not where the agent believes
it.

Prints one line of JSON: `picked` of `episodes`; `within` (3 mm and 2 degrees of the seed's pose) of `tries` to set a
cuboid down; how far the worst was off, of those within 20 mm and 10 degrees; `why` others were placed by the world;
`faults` after which the collection went on; how many episodes `replayed` in simulation with success; and the `problems`
of the others, by what they say.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import tyro
from rcs_data import Dataset

import rcs
from rcs.rollout import Collection, Progress, collect, reexecute
from rcs.rollout.supervisor import VirtualSupervisor
from rcs.virtual import VirtualProcess

MOST_MM, MOST_DEG = 3.0, 2.0
"""Largest distance and angle from the seed's pose."""


class Patient(VirtualSupervisor):
    """Goes on after a fault, which counts."""

    faults = 0

    def may_recover(self, faults: str) -> bool:
        """Agree."""
        print(faults, file=sys.stderr)
        self.faults += 1
        return True


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    episodes: int = 20
    """Number of episodes; the first cuboid is placed by the world."""
    seed: int = 0
    """Random seed."""
    address: str = "127.0.0.33"
    """Address of the virtual arm."""


def main(options: Options) -> None:
    """Measure and print."""
    setup = rcs.Setup(task_options={"placed_by": "robot"})
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "placed"
        with VirtualProcess("fr3", address=options.address) as virtual:
            collection = Collection(
                setup=setup,
                out=out,
                episodes=options.episodes,
                seed=options.seed,
                hardware=virtual.site,
                home_speed=0.5,
            )
            supervisor = Patient(virtual.name)
            for _ in collect(collection, Progress(), supervisor=supervisor):
                pass
        episodes = Dataset.open(out).episodes
        placed = [episode.outcome["placed"] for episode in episodes]
        again = list(reexecute(out, Path(folder) / "again", kind="states"))
    tries = [one for one in placed if one.get("why") != "no success before"]
    by_robot = [one for one in tries if one["by"] == "robot"]
    print(
        json.dumps(
            {
                "benchmark": "placing",
                "episodes": len(episodes),
                "picked": sum(episode.success is True for episode in episodes),
                "tries": len(tries),
                "within": sum(one["off_mm"] <= MOST_MM and one["off_deg"] <= MOST_DEG for one in by_robot),
                "worst_mm": max((one["off_mm"] for one in by_robot), default=None),
                "worst_deg": max((one["off_deg"] for one in by_robot), default=None),
                "why": Counter(one["why"] for one in tries if one["by"] != "robot"),
                "faults": supervisor.faults,
                "replayed": sum(one.success for one in again),
                "problems": Counter(one.problem or "no success" for one in again if not one.success),
            }
        )
    )


if __name__ == "__main__":
    main(tyro.cli(Options))
