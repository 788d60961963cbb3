"""Random and violent commands in every control, and what of it the robot is sent: speed, acceleration, jerk, range.

The points are those that the robot took from the wire. An FR3 is sent torques; its points are those that the vendor's
library is given, and of the torques there are the share of the motors' and the rate, in 1000 N·m/s.
"""

from __future__ import annotations

import time
from collections import Counter
from typing import Any

import numpy as np
from rehearsal.stage import OPEN, RATES, Array, Stage, range_of, recover, stage

from rcs.devices import Arm, ArmLimits, lookup
from rcs.errors import DeviceFault, InvalidAction
from rcs.hardware.franka import FrankaArm
from rcs.robots import FR3

WINDOWS = (1, 2, 5, 10, 20)
"""Numbers of setpoints over which differences are taken. A mean over a window is within the limits if the setpoints
are, and the possible error by rounding on the wire, which is subtracted, decreases with the length of the window."""
QUANTA = {"so101": 2 * np.pi / 4096, "xarm7": 2.4e-7}
"""Quantisation of positions on the wire [rad]: steps of the encoder, single precision."""
RESTART = 0.25
"""Longest pause within a stream of setpoints [s]."""
TORQUE_RATE = 1000.0
"""Torque rate that an FR3's controller admits [N·m/s]."""
FREQUENCY = 90.0
"""Control rate of environments [Hz]; the drivers themselves receive up to 1000 commands a second."""
CONTROLS = ("joints", "xyzrpy", "tquat", "twist")
REACH = 0.25
"""Largest distance of joints from home, which is free of obstacles [rad]."""


def worst(times: Array, points: Array, rate: float, limits: ArmLimits, quantum: float = 0.0) -> dict[str, Any]:
    """Return the largest speed, acceleration and jerk of points (N, dof) at a rate [Hz], in shares of the limits."""
    bounds = (limits.joint_velocity, limits.joint_acceleration, limits.joint_jerk)
    found = [0.0, 0.0, 0.0]
    for part in streams(times, points):
        for window in WINDOWS:
            ways = part
            for order, bound in enumerate(bounds, 1):
                ways = ways[window:] - ways[:-window]
                excess = np.maximum(np.abs(ways) - 2 ** (order - 1) * quantum, 0.0) * (rate / window) ** order
                found[order - 1] = max(found[order - 1], float((excess / np.array(bound)).max(initial=0.0)))
    lower, upper = np.array(limits.joint_lower) - quantum / 2, np.array(limits.joint_upper) + quantum / 2
    outside = (points < lower - 1e-9) | (points > upper + 1e-9)
    names = ("worst_speed", "worst_acceleration", "worst_jerk")
    return {name: round(value, 4) for name, value in zip(names, found, strict=True)} | {
        "outside": int(outside.any(axis=1).sum())
    }


def streams(times: Array, points: Array) -> list[Array]:
    """Return points from pause to pause."""
    return np.split(points, np.flatnonzero(np.diff(times) > RESTART) + 1)


def next_target(random: np.random.Generator, target: Array, lower: Any, upper: Any) -> Array:
    """Return a target: anywhere, at the ends of the ranges, a step away, or a small step away."""
    kind = random.random()
    if kind < 0.3:
        return random.uniform(lower, upper)
    if kind < 0.35:
        return np.where(random.random(len(target)) < 0.5, lower, upper)
    return np.clip(target + random.normal(0.0, 0.2 if kind < 0.5 else 0.02, len(target)), lower, upper)


def command_driver(arm: Arm, home: Array, commands: int, ends: Counter[str]) -> None:
    """Command an arm at random moments, up to 1000 times a second, with times to live and holds between."""
    random = np.random.default_rng(0)
    arm.open()
    lower, upper = range_of(arm, home, REACH)
    target, gap, until = np.array(arm.state().joints), 0.0, 0.0
    arm.command_joints(target)
    time.sleep(0.3)
    for _ in range(commands):
        if time.monotonic() > until:  # another hand
            gap, until = random.choice([1e-3, 2e-3, 5e-3, 1 / 30]), time.monotonic() + 0.5
        target = next_target(random, target, lower, upper)
        try:
            arm.command_joints(target, random.choice([0.02, 0.1, 1.0]))
            if random.random() < 0.01:
                arm.hold()
        except InvalidAction:
            ends["refused"] += 1
            target = np.array(arm.state().joints)
        except DeviceFault:
            ends[recovered(arm)] += 1
        time.sleep(gap * random.choice([1.0, random.uniform(0.1, 4.0)], p=[0.8, 0.2]))
    arm.close()


def recovered(arm: Arm) -> str:
    """Return the fault of an arm that has recovered from it."""
    told = first_words(arm.fault)
    time.sleep(2 * RESTART)
    recover(arm)
    arm.command_joints(arm.state().joints)
    time.sleep(2 * RESTART)
    return told


def first_words(text: str) -> str:
    """Return the beginning of a message."""
    return " ".join(text.split()[:16])


def command_env(one: Stage, control: str, commands: int, ends: Counter[str]) -> None:
    """Command an environment, every period: somewhere near, as fast as it lets, and back, and the gripper with it."""
    random = np.random.default_rng(1)
    relative = "last_step" if control in ("joints", "twist") else "absolute"
    with one.env(control=control, relative=relative, frequency=FREQUENCY, binary_gripper=False) as env:
        observation, _ = env.reset()
        space, grip = env.action_space[control], OPEN
        action = start = np.array(observation[control]) if relative == "absolute" else np.zeros(space.shape)
        way = action
        for k in range(commands):
            if k % 20 == 0:  # there and back
                way = np.where(random.random(space.shape) < 0.5, space.low, space.high) if k % 40 == 0 else -way
                grip = random.uniform(0.0, 1.0, 1)
            if relative == "last_step":
                action = way * random.choice([1.0, random.random()])
            elif k % 10 == 5:
                action = somewhere(random, start)
            try:
                _, _, _, truncated, info = env.step({control: action, "gripper": grip})
            except InvalidAction:
                ends["refused"] += 1
                continue
            ends["refused"] += "refused" in info
            if truncated:
                ends[first_words(str(info.get("faults", info["end"])))] += 1
                time.sleep(2 * RESTART)
                recover(env)
                env.reset()
                action = start
                time.sleep(2 * RESTART)


def somewhere(random: np.random.Generator, start: Array) -> Array:
    """Return a pose near another one, in either form."""
    place = start[:3] + random.uniform(-0.1, 0.1, 3)
    if len(start) == 6:
        return np.concatenate([place, start[3:] + random.uniform(-0.3, 0.3, 3)])
    turn = start[3:] + random.uniform(-0.15, 0.15, 4)
    return np.concatenate([place, turn / np.linalg.norm(turn)])


def measure(robot: str, commands: int) -> dict[str, Any]:
    """Return the figures of a robot under so many commands, six in ten of them to its driver."""
    given: list[tuple[float, Array]] = []
    ends: Counter[str] = Counter()
    with stage(robot) as one, recording_franka(given):
        arm, _ = one.devices(**({"host": False} if robot == "fr3" else {}))
        limits = arm.limits
        home = np.array(lookup.find("arm", robot).home)
        command_driver(arm, home, commands * 6 // 10, ends)
        for control in CONTROLS:
            time.sleep(2 * RESTART)
            command_env(one, control, commands // 10, ends)
        one.virtual.close()
        ticks, points = one.ticks(), one.points()
        late = one.robot_late()
    found: dict[str, Any] = {"commands": commands, "points": len(points)}
    if robot == "fr3":
        found |= torques_of(points)
        times, places = np.array([at for at, _ in given]), np.array([point for _, point in given])
    else:
        times, places = points["time"], points["joints"]
    if robot == "so101":  # a stream ends with the goal to stay where the servos are, which is no point of it
        kept = np.append(np.diff(times) <= RESTART, False)
        times, places = times[kept], places[kept]
    if robot == "ur5e":  # the first is where the arm stands, and goes before the stream
        kept = np.insert(np.diff(times) <= RESTART, 0, False)
        times, places = times[kept], places[kept]
    found |= worst(times, places, RATES[robot], limits, QUANTA.get(robot, 0.0))
    speed = np.abs(ticks["velocities"]).max(axis=0) / np.array(limits.joint_velocity)
    return found | {"measured_speed": round(float(speed.max()), 3), "ends": dict(ends), "robot_late": late}


def torques_of(points: Any) -> dict[str, float]:
    """Return the largest torque, in shares of the motors', and its rate, in shares of the controller's limit."""
    sent = points["torques"]
    ticks = np.maximum(np.round(1e3 * np.diff(points["time"])), 1.0)
    rates = np.abs(np.diff(sent, axis=0)).max(axis=1) * 1e3 / ticks / TORQUE_RATE
    return {
        "worst_torque": round(float((np.abs(sent) / np.array(FR3.effort_limit)).max()), 4),
        "worst_torque_rate": round(float(rates[ticks < 1e3 * RESTART].max()), 4),
    }


class recording_franka:  # noqa: N801  a context
    """Keeps the points that the driver of the FR3 gives to the vendor's library, with their times."""

    def __init__(self, into: list[tuple[float, Array]]) -> None:
        self._into, self._write = into, FrankaArm._write

    def __enter__(self) -> None:
        """Begin."""
        write, into = self._write, self._into

        def keep(arm: FrankaArm, point: Any) -> None:
            into.append((time.monotonic(), np.array(point.position)))
            write(arm, point)

        FrankaArm._write = keep  # type: ignore[method-assign]

    def __exit__(self, *_: object) -> None:
        """End."""
        FrankaArm._write = self._write  # type: ignore[method-assign]
