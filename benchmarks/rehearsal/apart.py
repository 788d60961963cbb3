"""Compare the joints in simulation and on the virtual robot for the same actions, up to a common lag."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from rehearsal.stage import GRIPPERS, OPEN, Array, stage

import rcs

LAGS = np.arange(-0.05, 0.4, 5e-4)
"""Lags of the virtual robot behind the simulated one [s]."""
SETTLE = 1.0
"""Time at rest at the end [s]."""


def actions_of(dof: int) -> dict[str, Array]:
    """Return relative joint actions (N, dof): waves of all joints, and moves from stand to stand as an expert's."""
    times = np.arange(150) / 30
    phases = 2 * np.pi * 0.4 * times[:, None] * (1 + 0.1 * np.arange(dof))
    waves = (
        0.12 * (1 - np.cos(phases)) * np.where(np.arange(dof) % 2, -1.0, 1.0) * np.minimum(times / 1.0, 1.0)[:, None]
    )
    random, place, ways = np.random.default_rng(0), np.zeros(dof), [np.zeros((1, dof))]
    for _ in range(5):
        goal = random.uniform(-0.15, 0.15, dof)
        share = np.linspace(0.0, 1.0, 31)[1:, None]
        ways.append(place + (goal - place) * (10 * share**3 - 15 * share**4 + 6 * share**5))  # least jerk, a second
        place = goal
    still = np.zeros((round(30 * SETTLE), dof))
    return {
        name: np.concatenate([np.diff(way, axis=0), still])
        for name, way in {"smooth": waves, "moves": np.concatenate(ways)}.items()
    }


def play(env: rcs.Env, actions: Array) -> tuple[Array, Array, float]:
    """Return the start of each step, the joints after it, and the lateness of steps [s]."""
    begins, joints, late = [], [], 0.0
    for action in actions:
        begins.append(time.monotonic())
        observation, _, _, truncated, info = env.step({"joints": action, "gripper": OPEN})
        if truncated:
            raise RuntimeError(str(info.get("faults", info["end"])))
        joints.append(observation["joints"])
        late = max(late, info.get("late", 0.0))
    return np.array(begins), np.array(joints), late


def compare(begins: Array, simulated: Array, times: Array, real: Array) -> tuple[float, float]:
    """Return the largest distance of any joint [mrad] and the lag for which it is least [ms]."""
    ends = begins + 1 / 30

    def distance(lag: float) -> float:
        moved = np.stack([np.interp(ends + lag, times, real[:, joint]) for joint in range(real.shape[1])], axis=1)
        return float(np.abs(moved - simulated).max())

    lag = min(LAGS, key=distance)
    return 1e3 * distance(lag), 1e3 * lag


def measure(robot: str) -> dict[str, Any]:
    """Return the figures of a robot."""
    found: dict[str, Any] = {}
    with stage(robot) as one:
        played = {}
        with one.env() as env:
            observation, _ = env.reset()
            start = observation["joints"]
            most = env.action_space["joints"].high
            everything = {
                name: actions * min(0.8 * float((most / np.abs(actions).max(axis=0)).min()), 1.0)
                for name, actions in actions_of(len(start)).items()
            }
            play(env, np.zeros((15, len(start))))  # switching on takes its time
            for name, actions in everything.items():
                played[name] = (np.array(observation["joints"]), *play(env, actions))
                observation = {"joints": played[name][2][-1]}
        one.virtual.close()
        ticks = one.ticks()
    for name, (start, begins, _, late) in played.items():
        options: Any = {"robot": robot, "end_effector": GRIPPERS.get(robot), "max_episode_steps": None}
        with rcs.make("Free", **options) as env:
            env.reset(options={"robot": {"joints": start, "gripper": OPEN}})
            _, simulated, _ = play(env, everything[name])
        apart, lag = compare(begins, simulated, ticks["time"], ticks["joints"])
        found[name] = {
            "apart_mrad": round(apart, 2),
            "lag_ms": round(float(lag), 1),
            "late_max_ms": round(1e3 * late, 1),
        }
    return {"apart_mrad": max(one["apart_mrad"] for one in found.values()), **found}
