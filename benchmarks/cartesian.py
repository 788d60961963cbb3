"""Measure how well arms follow poses: drift of the elbow, direction of cut steps, straightness, bounded joint steps.

- Drift: laps of a circle of 24 cm through home; the largest change of a joint when the TCP is back, and how far it is
  then from where it was (FR3, xArm7).
- Direction: uniform random actions in relative control. Wherever a step was cut, the angle between the translation that
  was asked for and that of the target that was sent.
- Lines: straight paths from home at 0.25 m/s in random directions, beyond the reach too; the largest joint step over
  that of the speed limits, and how far off the lines within the reach the targets are.

All figures are of targets, which is what the inverse kinematics answers for. Prints one JSON object: `worst_drift_rad`,
`worst_direction_p90_deg`, `worst_step_over_limit`, `worst_beside_mm`, and the same per arm.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

import rcs
from rcs.envs.spaces import GRIPPER, HAND, JOINTS, TQUAT
from rcs.kinematics import IkStatus, Kinematics, kinematics_of
from rcs.spatial import distance

Row = NDArray[np.float64]


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    laps: int = 30
    """Laps of the circle."""
    steps: int = 6000
    """Random actions per arm and control mode, 150 per episode."""
    lines: int = 20
    """Straight paths per arm."""
    seed: int = 0
    """Random seed of actions and paths."""


class Follower:
    """An environment without a task, and the targets that it sends."""

    def __init__(self, robot: str, **setup: Any) -> None:
        self.env = rcs.make("Free", robot=robot, max_episode_steps=None, collision_reaction=False, **setup)
        placement = self.env.robots[robot]
        self.home = np.array(placement.arm.home)
        self.largest_step = np.array(placement.arm.velocity_limit) / self.env.setup.frequency
        self.kinematics: Kinematics = kinematics_of(placement.arm, placement.end_effector)
        self.joints = self.home
        self.is_limited, self.status = False, IkStatus.ok.value

    def reset(self, seed: int) -> Row:
        """Start an episode; return the TCP pose."""
        self.joints = self.env.reset(seed=seed)[0][JOINTS]
        return self.tcp()

    def tcp(self) -> Row:
        """Return the pose of the last target."""
        return self.kinematics.forward(self.joints).tquat

    def step(self, arm: Row) -> Row:
        """Send an action of the arm; return the change of the joint targets."""
        others = {key: np.ones(1, np.float32) for key in (GRIPPER, HAND) if key in self.env.action_space.spaces}
        *_, info = self.env.step({self.env.setup.control: arm, **others})
        before, self.joints = self.joints, self.env.stack.executed[JOINTS]
        self.is_limited, self.status = bool(info["is_limited"]), int(info["ik_status"])
        return self.joints - before


def drift(robot: str, laps: int) -> tuple[float, float]:
    """Return the largest change of a joint [rad] and the distance of the TCP [m] after any of some laps."""
    arm = Follower(robot, control=TQUAT, relative=False)
    start = arm.reset(0)
    joints = arm.joints
    worst = np.zeros(2)
    for k in range(120 * laps):
        angle = 2 * np.pi * (k + 1) / 120
        target = start.copy()
        target[:2] += 0.12 * np.array([np.cos(angle) - 1, np.sin(angle)])
        arm.step(target)
        if (k + 1) % 120 == 0:
            now = np.abs(arm.joints - joints).max(), float(distance(arm.tcp(), start)[0])
            worst = np.maximum(worst, now)
    return float(worst[0]), float(worst[1])


def directions(robot: str, control: str, steps: int, seed: int) -> tuple[Row, float]:
    """Return the angles of cut steps [rad] and the share of steps that were cut."""
    arm = Follower(robot, control=control)
    arm.env.action_space.seed(seed)
    angles: list[float] = []
    cut = 0
    for k in range(steps):
        if k % 150 == 0:
            arm.reset(seed + k)
        before = arm.tcp()
        asked = np.asarray(arm.env.action_space.sample()[control])
        arm.step(asked)
        if arm.status == IkStatus.ok.value and not arm.is_limited:
            continue
        cut += 1
        done = arm.tcp()[:3] - before[:3]
        cosine = done @ asked[:3] / max(float(np.linalg.norm(done) * np.linalg.norm(asked[:3])), 1e-12)
        angles.append(float(np.arccos(np.clip(cosine, -1, 1))))
    return np.array(angles), cut / steps


def lines(robot: str, count: int, seed: int) -> tuple[float, float]:
    """Return the largest joint step over its limit, and the distance from lines that never leave the reach [m]."""
    arm = Follower(robot, control=TQUAT, relative=False)
    rng = np.random.default_rng(seed)
    steepest, beside = 0.0, 0.0
    for _ in range(count):
        start = arm.reset(0)
        way = rng.normal(size=3)
        way *= rng.uniform(0.3, 1.2) * np.linalg.norm(start[:3]) / np.linalg.norm(way)
        end = start.copy()
        end[:3] += way
        if (np.abs(end[:3]) > 1.9).any():
            continue
        steps = max(2, round(float(np.linalg.norm(way)) / 0.25 * arm.env.setup.frequency))
        off, is_within = 0.0, True
        for k in range(steps + 30):
            target = start.copy()
            target[:3] += min(1.0, (k + 1) / steps) * way
            steepest = max(steepest, float((np.abs(arm.step(target)) / arm.largest_step).max()))
            miss = arm.tcp()[:3] - start[:3]
            off = max(off, float(np.linalg.norm(miss - (miss @ way) / (way @ way) * way)))
            is_within = is_within and arm.status != IkStatus.nearest.value
        beside = max(beside, off if is_within else 0.0)
    return steepest, beside


def main(options: Options) -> None:
    """Measure and print."""
    robots = ("fr3", "ur5e", "xarm7", "so101")
    drifts = {robot: drift(robot, options.laps) for robot in ("fr3", "xarm7")}
    angles = {
        f"{robot} {control}": directions(robot, control, options.steps, options.seed)
        for robot in robots
        for control in ("xyzrpy", TQUAT)
    }
    p90 = {
        key: round(float(np.degrees(np.quantile(found, 0.9))), 2) for key, (found, _) in angles.items() if len(found)
    }
    paths = {robot: lines(robot, options.lines, options.seed) for robot in robots}
    result = {
        "benchmark": "cartesian",
        "worst_drift_rad": round(max(joint for joint, _ in drifts.values()), 4),
        "worst_direction_p90_deg": max(p90.values(), default=0.0),
        "worst_step_over_limit": round(max(step for step, _ in paths.values()), 4),
        "worst_beside_mm": round(1e3 * max(beside for _, beside in paths.values()), 3),
        "drift_rad": {robot: round(joint, 4) for robot, (joint, _) in drifts.items()},
        "drift_of_tcp_mm": {robot: round(1e3 * tcp, 4) for robot, (_, tcp) in drifts.items()},
        "direction_p90_deg": p90,
        "share_cut": {key: round(cut, 3) for key, (_, cut) in angles.items()},
        "step_over_limit": {robot: round(step, 4) for robot, (step, _) in paths.items()},
        "beside_mm": {robot: round(1e3 * beside, 3) for robot, (_, beside) in paths.items()},
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main(tyro.cli(Options))
