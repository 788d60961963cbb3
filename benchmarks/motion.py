"""Measure the motion of the simulated arms: peaks over their limits, settling, and tracking of a line.

For every arm and stepping: steps of 0.1 to 2 rad of all joints from the home pose (as far as their ranges go), a
stream of random joint targets, and a line of 0.25 m/s by poses. `speed`, `acceleration` and `jerk` are the largest
that any joint is commanded to, over its limits in the description, from the trajectory that leads the servos;
`measured_speed` and `measured_acceleration` are those of the simulated joints, the latter over windows of 10 ms. The
line starts and ends with half a second of constant acceleration; `behind` and `beside` are the largest distances of
the TCP from where the target of the step was, along and across the line, at the ends of the steps at full speed.

The law of single moves: every joint goes from home by ten sizes up to its range, to both sides, at 10, 30 and 100 Hz
and synchronously. `wrong_way` is how far the trajectory goes away from the target [rad], `past` how far it goes past
it, `turns` how often its acceleration changes sign, `measured_past` how far the simulated joint goes past. The same
along straight ways of the TCP by absolute poses, relative poses and velocities, of 5 cm: `tcp_wrong_way_mm`,
`tcp_past_mm`.

Prints a table, then one JSON object: `worst_speed`, `worst_acceleration`, `worst_jerk`, the worst of the law, and a row
per arm and stepping.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import rcs
from rcs.envs.env import Env
from rcs.sim.robot import SimRobot

SPEED = 0.25
"""Speed along the line [m/s]."""
RAMP = 0.5
"""Time from rest to full speed [s]."""
WINDOW = 5
"""Physics steps over which accelerations are measured."""
DIRECTIONS = {"fr3": (0, 1, 0), "ur5e": (1, 0, 0), "xarm7": (0, 1, 0), "so101": (0, 1, 0)}
"""Directions of the line in the base frame: across in front of the robot."""


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    robots: tuple[str, ...] = ("fr3", "xarm7", "ur5e", "so101")
    """Robots."""
    stream: int = 300
    """Steps of the stream of random targets."""
    seed: int = 0
    """Random seed of the stream."""


class Log:
    """The motion of an arm in every physics step."""

    def __init__(self, env: Env) -> None:
        """Watch the only robot of an environment."""
        self.robot: SimRobot = env.simulation.robots[0]
        self._rows: list[NDArray[np.float64]] = []
        self.physics_step = float(self.robot.world.model.opt.timestep)
        env.simulation.world.on_period(self._note, self.physics_step)

    def _note(self, view: Any) -> bool:
        ids = self.robot.layout
        self._rows.append(np.stack([*self.robot.motion.state(view), view.qpos[ids.qpos], view.qvel[ids.qvel]]))
        return False

    def take(self) -> NDArray[np.float64]:
        """Return commanded position, velocity and acceleration, measured position and velocity, (5, n, dof); forget."""
        rows = np.stack(self._rows, axis=1)
        self._rows.clear()
        return rows


def peaks(rows: NDArray[np.float64], robot: SimRobot, physics_step: float) -> dict[str, float]:
    """Return the peaks of a motion over the limits."""
    arm = robot.placement.arm
    _, velocity, acceleration, _, measured = rows
    change = (measured[WINDOW:] - measured[:-WINDOW]) / (WINDOW * physics_step)
    return {
        "speed": over(velocity, arm.velocity_limit),
        "acceleration": over(acceleration, arm.acceleration_limit),
        "jerk": over(np.diff(acceleration, axis=0) / physics_step, arm.jerk_limit),
        "measured_speed": over(measured, arm.velocity_limit),
        "measured_acceleration": over(change, arm.acceleration_limit),
    }


def over(values: NDArray[np.float64], limits: tuple[float, ...]) -> float:
    """Return the largest ratio of a value to its limit."""
    return float((np.abs(values) / np.array(limits)).max())


def make(robot: str, stepping: str, **fields: Any) -> Env:
    """Make an empty scene without contacts: what is measured is how arms move, not what they hit."""
    env = rcs.make("Free", robot=robot, stepping=stepping, relative="absolute", max_episode_steps=None, **fields)
    env.simulation.world.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return env


def filled(env: Env, key: str, target: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """Return an action with a target and an open gripper."""
    return {name: target if name == key else np.ones(box.shape, box.dtype) for name, box in env.action_space.items()}


def steps(env: Env, log: Log) -> dict[str, float]:
    """Step all joints by 0.1 to 2 rad, to one side and back; return peaks, overshoot and settling."""
    found: dict[str, float] = {}
    box = env.action_space["joints"]
    for size in (0.1, 0.3, 1.0, 2.0):
        for sign in (1, -1):
            observation, _ = env.reset(seed=0)
            home = observation["joints"]
            target = np.clip(home + sign * size, box.low + 0.02, box.high - 0.02)
            log.take() if log._rows else None
            start = env.simulation.world.time.item()
            for _ in range(1 if env.simulation.world.stepping == "sync" else 150):
                env.step(filled(env, "joints", target))
            took = env.simulation.world.time.item() - start
            rows = log.take()
            reached = rows[3] - target
            past = np.where(target > home, reached, -reached).max()
            within = np.abs(reached).max(axis=1) < 1e-3
            # From when the trajectory has ended until every joint stays within a milliradian of its target.
            settled = (len(within) - np.argmin(within[::-1])) * log.physics_step if within[-1] else np.inf
            led = int(np.argmax((np.abs(rows[0] - target) < 1e-9).all(axis=1))) * log.physics_step
            one = peaks(rows, log.robot, log.physics_step)
            one |= {"overshoot_deg": float(np.degrees(max(past, 0.0))), "settling_s": float(settled - led)}
            one |= {"step_of_2_rad_s": took if size == 2.0 and env.simulation.world.stepping == "sync" else 0.0}
            found = {key: max(value, found.get(key, 0.0)) for key, value in one.items()}
    return found


def stream(env: Env, log: Log, options: Options) -> dict[str, float]:
    """Follow random targets; return peaks."""
    draws = np.random.default_rng(options.seed)
    observation, _ = env.reset(seed=0)
    box = env.action_space["joints"]
    home = observation["joints"]
    for k in range(options.stream):
        width = (0.05, 0.5, 3.0)[k * 3 // options.stream]
        target = np.clip(home + draws.uniform(-width, width, box.shape), box.low, box.high)
        env.step(filled(env, "joints", target))
    return peaks(log.take(), log.robot, log.physics_step)


def line(robot: str, **fields: Any) -> dict[str, float]:
    """Follow a line by poses at 30 Hz; return how far the TCP is behind and beside the targets [mm]."""
    env = make(robot, "async", control="tquat", **fields)
    observation, _ = env.reset(seed=0)
    start = observation["tquat"].copy()
    along = np.array(DIRECTIONS[robot], float)
    period, length = 1 / 30, 0.3 if robot != "so101" else 0.2
    offset = -length / 2 * along
    for k in range(1, 61):  # slowly to where the line starts
        target = start.copy()
        target[:3] += offset * k / 60
        observation, *_ = env.step(filled(env, "tquat", target))
    for _ in range(15):
        observation, *_ = env.step(filled(env, "tquat", target))
    begin, errors = target.copy(), []
    duration = length / SPEED + RAMP
    for k in range(1, int(duration / period) + 1):
        t = k * period
        rest = duration - t
        way = SPEED / (2 * RAMP) * min(t, RAMP) ** 2 + SPEED * max(min(t, duration - RAMP) - RAMP, 0.0)
        way += SPEED / (2 * RAMP) * (RAMP**2 - min(rest, RAMP) ** 2) if rest < RAMP else 0.0
        target = begin.copy()
        target[:3] += way * along
        observation, *_ = env.step(filled(env, "tquat", target))
        if RAMP <= t <= duration - RAMP:
            errors.append(observation["tquat"][:3] - target[:3])
    env.close()
    behind = np.array(errors) @ along
    beside = np.linalg.norm(np.array(errors) - behind[:, None] * along, axis=1)
    return {"behind_mm": 1e3 * float(np.abs(behind).max()), "beside_mm": 1e3 * float(beside.max())}


FREQUENCIES = (10.0, 30.0, 100.0)
"""Rates of targets [Hz]."""
SIZES = 10
"""Sizes of moves of each joint to each side: four small ones, then up to the end of its range."""
EDGE = 0.02
"""Distance that targets keep from the ends of the range [rad]."""


def moves(robot: str, stepping: str, frequency: float) -> dict[str, float]:
    """Move every joint alone, by all sizes to both sides; return the worst of the law."""
    env = make(robot, stepping, control="joints", frequency=frequency)
    log, box = Log(env), env.action_space["joints"]
    arm = log.robot.placement.arm
    found = dict.fromkeys(("wrong_way", "past", "turns", "measured_past"), 0.0)
    for joint in range(arm.dof):
        for sign in (1, -1):
            home = np.array(arm.home)
            edge = sign * ((box.high if sign > 0 else box.low)[joint] - home[joint]) - EDGE
            for size in edge * np.concatenate([0.005 * 2.5 ** np.arange(4), np.linspace(0.2, 1.0, SIZES - 4)]):
                if size < 1e-3:
                    continue
                env.reset(seed=0)
                env.simulation.robots[0].put(home)
                target = home.copy()
                target[joint] += sign * size
                log.take() if log._rows else None
                steps = 1 if stepping == "sync" else int((size / arm.velocity_limit[joint] + 1.3) * frequency)
                for _ in range(steps):
                    env.step(filled(env, "joints", target))
                position, _, acceleration, measured, _ = log.take()[:, :, joint]
                way, real = sign * (position - home[joint]), sign * (measured - home[joint])
                signs = np.sign(acceleration[np.abs(acceleration) > 0.02 * arm.acceleration_limit[joint]])
                one = {"wrong_way": -way.min(), "past": way.max() - size, "measured_past": real.max() - size}
                one["turns"] = np.count_nonzero(np.diff(signs))
                found = {key: max(value, float(one[key])) for key, value in found.items()}
    env.close()
    return found


def straight(robot: str, control: str, *, is_absolute: bool) -> dict[str, float]:
    """Move the TCP by 5 cm in one target, or for a third of a second by the largest relative action."""
    relative = {"relative": "absolute"} if is_absolute else {}
    env = rcs.make("Free", robot=robot, control=control, max_episode_steps=None, **relative)
    env.simulation.world.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    along = np.array(DIRECTIONS[robot], float)
    observation, _ = env.reset(seed=0)
    start, seen = observation["tquat"][:3].copy(), [0.0]
    box = env.action_space[control]
    action = np.zeros(box.shape)
    for k in range(60):
        if not is_absolute:
            action = np.zeros(box.shape)
            if control == "tquat":
                action[6] = 1.0  # no turn
            action[:3] = along * box.high[:3] * (k < 10)
        elif k == 0:
            action = observation[control].copy()
            action[:3] += 0.05 * along
        observation, *_ = env.step(filled(env, control, action))
        seen.append(float((observation["tquat"][:3] - start) @ along))
    env.close()
    return {"tcp_wrong_way_mm": -1e3 * min(seen), "tcp_past_mm": 1e3 * (max(seen) - seen[-1])}


def law(robot: str) -> dict[str, float]:
    """Return the worst of all single moves of an arm."""
    found = [moves(robot, "sync", 30.0), *(moves(robot, "async", frequency) for frequency in FREQUENCIES)]
    found += [straight(robot, control, is_absolute=True) for control in ("tquat", "xyzrpy")]
    found += [straight(robot, control, is_absolute=False) for control in ("tquat", "xyzrpy", "twist")]
    return {key: max(one[key] for one in found if key in one) for key in {key for one in found for key in one}}


def main(options: Options) -> None:
    """Measure and print."""
    rows: list[dict[str, Any]] = []
    for robot in options.robots:
        for stepping in ("sync", "async"):
            env = make(robot, stepping, control="joints")
            log = Log(env)
            row: dict[str, Any] = {"robot": robot, "stepping": stepping, **steps(env, log)}
            row |= {f"stream_{key}": value for key, value in stream(env, log, options).items()}
            env.close()
            rows.append(row | ({**line(robot), **law(robot)} if stepping == "async" else {}))
    table = Table(*rows[-1], title="Motion of the arms; peaks are over their limits")
    for row in rows:
        table.add_row(
            *(
                str(round(row.get(key, 0.0), 3) if isinstance(row.get(key, 0.0), float) else row[key])
                for key in rows[-1]
            )
        )
    Console(width=250).print(table)
    worst = {
        f"worst_{key}": round(max(row[name] for row in rows for name in (key, f"stream_{key}")), 4)
        for key in ("speed", "acceleration", "jerk", "measured_speed", "measured_acceleration")
    }
    keys = ("wrong_way", "past", "turns", "measured_past", "tcp_wrong_way_mm", "tcp_past_mm")
    worst |= {f"worst_{key}": round(max(row.get(key, 0.0) for row in rows), 4) for key in keys}
    print(json.dumps({"benchmark": "motion", **worst, "rows": rows}))


if __name__ == "__main__":
    main(tyro.cli(Options))
