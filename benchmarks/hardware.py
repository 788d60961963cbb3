"""Test drivers of arms, with the vendors' libraries, against virtual robots, by the robots' own logs.

    python benchmarks/hardware.py --robot fake | fr3 | ur5e | xarm7 | so101 | dual_fr3 | all

Prints one line of JSON per robot, and a last one for all. Measurements, each by a module of `rehearsal`:

- `sent`: under random and violent commands in every control, what the robot is sent in shares of its limits;
- `apart`: the same actions in simulation and on the virtual robot;
- `endings`: how long the robot goes on when its program is busy or has ended;
- `late`: ticks that come late beside a loop that records;
- `faults`: what follows every fault that the robot knows, with `--faults N`;
- `hosted`: how long it takes to start a host, to reach it, and to find that it hangs, of `fake`;
- `bus`: reads of an SO101's servos while packets are late, lost and damaged;
- `skew`: of the commands to two arms, of `dual_fr3`.

`fake` is a servo in Python that follows its setpoints at once, on a clock of its own. `robot_late` is the fraction of a
virtual robot's late ticks; above 0.01, the machine is too busy to measure times.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from typing import Any

from rehearsal import apart, bus, endings, fake, faults, hosted, late, sent, skew

ARMS = ("fr3", "ur5e", "xarm7", "so101")
ROBOTS = ("fake", *ARMS, "dual_fr3")


def measurements(robot: str, given: argparse.Namespace) -> dict[str, Callable[[], Any]]:
    """Return the measurements for a robot."""
    if robot == "fake":
        return {
            "sent": lambda: fake.measure(given.commands, given.seconds),
            "hosted": lambda: hosted.measure(given.tries),
        }
    if robot == "dual_fr3":
        return {"skew": lambda: skew.measure(given.seconds)}
    found: dict[str, Callable[[], Any]] = {
        "sent": lambda: sent.measure(robot, given.commands),
        "apart": lambda: apart.measure(robot),
        "endings": lambda: endings.measure(robot, given.tries),
        "late": lambda: late.measure(robot, given.seconds),
    }
    if given.faults:
        found["faults"] = lambda: faults.measure(robot, given.faults)
    if robot == "so101":
        found["bus"] = lambda: bus.measure(given.reads)
    return found


def measured(call: Callable[[], Any]) -> Any:
    """Return the result of a measurement, or the reason of its failure, so that the others continue."""
    try:
        return call()
    except Exception as err:  # noqa: BLE001  what fails is a finding
        return {"failed": f"{type(err).__name__}: {err}"}


def summary(lines: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the worst figure of all robots for each criterion."""

    def worst(part: str, name: str) -> Any:
        values = [line[part][name] for line in lines.values() if name in line.get(part, {})]
        return max((value for value in values if value is not None), default=None)

    names = {
        "sent": ("worst_speed", "worst_acceleration", "worst_jerk", "outside"),
        "apart": ("apart_mrad",),
        "endings": ("hold_p99_ms", "orphan_ms"),
        "late": ("late_ticks",),
        "bus": ("wrong",),
        "skew": ("skew_p99_ms",),
    }
    found = {name: worst(part, name) for part, own in names.items() for name in own}
    failed = [
        f"{robot}: {part}"
        for robot, line in lines.items()
        for part, one in line.items()
        if "failed" in one or one.get("fault")
    ]
    return {**{name: value for name, value in found.items() if value is not None}, "failed": failed}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", choices=(*ROBOTS, "all"), default="fake", help="what is measured")
    parser.add_argument("--only", nargs="+", metavar="PART", help="some of the measurements, such as: sent late")
    parser.add_argument("--commands", type=int, default=6_000, help="random commands")
    parser.add_argument("--seconds", type=float, default=10.0, help="in real time, for late ticks and skew")
    parser.add_argument("--tries", type=int, default=2, help="of each way to end, and of a host that hangs")
    parser.add_argument("--faults", type=int, default=0, help="moments for each fault")
    parser.add_argument("--reads", type=int, default=10_000, help="of servos")
    given = parser.parse_args()
    lines: dict[str, dict[str, Any]] = {}
    for robot in ROBOTS if given.robot == "all" else (given.robot,):
        parts = measurements(robot, given)
        lines[robot] = {
            part: measured(call) for part, call in parts.items() if given.only is None or part in given.only
        }
        print(json.dumps({"robot": robot, **lines[robot]}), flush=True)
    print(json.dumps({"benchmark": "hardware", "robots": list(lines), **summary(lines)}))


if __name__ == "__main__":
    main()
