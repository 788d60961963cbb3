"""The base of all measurements: a virtual robot with its devices, environments and log."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rcs
from rcs import Setup
from rcs.devices import Arm, Gripper, lookup
from rcs.envs import Env
from rcs.errors import RcsError
from rcs.hardware import Site
from rcs.setups.lab import lab_of
from rcs.virtual import VirtualProcess, read_events, read_points, read_ticks

RATES = {"fr3": 1000.0, "ur5e": 500.0, "xarm7": 250.0, "so101": 100.0}
"""Rate of packets to each robot [Hz]."""
GRIPPERS = {"xarm7": "robotiq_2f85"}
"""Grippers of robots whose default end effector is not a gripper."""
OPEN = np.ones(1)
RECOVERY = 8.0
"""Timeout for recovery [s]; a UR's protective stop lasts 5 s."""

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A running virtual robot."""

    robot: str
    virtual: VirtualProcess
    log: Path

    @property
    def site(self) -> Site:
        """Site of its devices; an SO101 stays powered, or it would fall whenever a program ends."""
        site = self.virtual.site
        if self.robot != "so101":
            return site
        address = site.arms[self.robot]
        address = {self.robot: replace(address, options={**address.options, "at_close": "hold"})}
        return replace(site, arms=address, grippers=address)

    def env(self, **options: Any) -> Env:
        """Return an environment with the robot."""
        given = {"hardware": self.site, "max_episode_steps": None, **options}
        return rcs.make("Free", robot=self.robot, end_effector=GRIPPERS.get(self.robot), **given)

    def devices(self, **options: Any) -> tuple[Arm, Gripper]:
        """Return arm and gripper, closed; options go to the driver of the arm."""
        lab, address = lab_of(self.robot), self.site.arms[self.robot]
        given = replace(address, options={**address.options, **options})
        site = replace(self.site, arms={self.robot: given})
        parts = (
            lookup.find("arm", lab.stands[0].arm),
            lookup.find("gripper", GRIPPERS.get(self.robot, lab.end_effector)),
        )
        made = site.devices({self.robot: parts}, {})
        return made.arms[self.robot], made.effectors[self.robot]

    def ticks(self, robot: str = "") -> NDArray[np.void]:
        """Return what the robot did, once it has ended."""
        return read_ticks(self.log, robot)

    def points(self, robot: str = "") -> NDArray[np.void]:
        """Return the setpoints that the robot received, after it has ended."""
        return read_points(self.log, robot)

    def robot_late(self) -> float:
        """Return the fraction of the robot's own ticks that were late, after it has ended."""
        end = read_events(self.log)[-1]
        return round(end["late"] / max(end["ticks"], 1), 5)


@contextmanager
def stage(robot: str) -> Generator[Stage]:
    """Run a virtual robot with a log, which is gone afterwards; close `virtual` to read it."""
    process = os.getpid()
    address = None if robot == "so101" else f"127.{64 + (process >> 8) % 64}.{process % 250 + 1}.31"
    with tempfile.TemporaryDirectory(prefix="rcs", dir="/tmp") as folder:
        log, setup = Path(folder) / "log.jsonl", Path(folder) / "setup.json"
        setup.write_text(json.dumps(Setup(task="Free", robot=robot, end_effector=GRIPPERS.get(robot)).to_json()))
        with VirtualProcess(robot, address=address, log=log, setup=setup) as virtual:
            yield Stage(robot=robot, virtual=virtual, log=log)


def range_of(arm: Arm, home: Array, reach: float) -> tuple[Array, Array]:
    """Return where joints may be led and hit nothing: the first and the last all of their way, others near home."""
    lower, upper = (np.array(bound) for bound in (arm.limits.joint_lower, arm.limits.joint_upper))
    near = np.full(len(home), reach)
    near[[0, -1]] = np.inf
    return np.maximum(lower, home - near), np.minimum(upper, home + near)


def recover(what: Arm | Env) -> str:
    """Recover, and return why that fails, or nothing."""
    until = time.monotonic() + RECOVERY
    while True:
        try:
            what.recover()
            return ""
        except RcsError as err:
            if time.monotonic() > until:
                return str(err)
            time.sleep(0.2)


def percentile(values: Any, share: float, digits: int = 1) -> float | None:
    """Return a percentile, None of nothing."""
    found = [value for value in values if value is not None]
    return round(float(np.percentile(found, share)), digits) if found else None
