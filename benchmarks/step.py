"""Measure the cost of an environment on top of its physics: `env.step` against MuJoCo's own `mj_step`.

Both run the same episode, a scripted pick of the cuboid, from the same state with the same number of physics steps.
The environment's trajectories give the servos a new control in every physics step. With these controls, MuJoCo must
reach the same states, which is checked once; the timed reference uses only the last control of each control step, which
is cheaper and excludes all costs of trajectories. Rounds of the two alternate, and the ratio is the median over rounds.

Prints one JSON object: `env_over_raw` (environment steps/s over raw), `env_steps_per_s`, `raw_steps_per_s`.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from statistics import median
from typing import Any

import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray

import rcs
from rcs.agents import agent_for


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    rounds: int = 41
    """Alternating rounds of one episode each."""
    seed: int = 0
    """Random seed of the episode."""


def record(
    seed: int,
) -> tuple[list[dict[str, NDArray[Any]]], list[list[NDArray[np.float64]]], NDArray[np.float64], NDArray[np.float64]]:
    """Return the actions of an episode, its controls by control and physics step, and its first and last state."""
    env = rcs.make(rcs.Setup())
    world = env.simulation.world
    controls: list[list[NDArray[np.float64]]] = []
    world.on_period(lambda view: controls[-1].append(view.ctrl.copy()), world.model.opt.timestep)
    expert = agent_for(env)
    observation, info = env.reset(seed=seed)
    expert.reset(observation, info)
    start = world.states().copy()
    actions = []
    is_over = False
    while not is_over:
        action = expert.act(observation, info)
        controls.append([])
        observation, _, terminated, truncated, info = env.step(action)
        actions.append(action)
        is_over = terminated or truncated
    final = world.states().copy()
    env.close()
    return actions, controls, start, final


def main(options: Options) -> None:
    """Measure and print."""
    actions, controls, start, final = record(options.seed)
    env = rcs.make(rcs.Setup())
    world = env.simulation.world
    steps = len(actions)

    def run_env() -> float:
        env.reset(seed=options.seed)
        begin = time.perf_counter()
        for action in actions:
            env.step(action)
        return time.perf_counter() - begin

    model, data = world.model, world.data
    assert data is not None

    def run_raw() -> float:
        world.core.set_state(start)
        begin = time.perf_counter()
        for control in controls:
            data.ctrl[:] = control[-1]
            mujoco.mj_step(model, data, len(control))
        return time.perf_counter() - begin

    run_env()
    same = np.array_equal(world.states(), final)
    world.core.set_state(start)
    for control in (row for rows in controls for row in rows):
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
    physics = slice(0, model.nq + model.nv + 1)  # the rest has the motion of the arm
    same = same and np.array_equal(world.states()[physics], final[physics])
    pairs = []
    for i in range(options.rounds):
        # In turns, so that a machine that gets slower does not favour one of them.
        if i % 2:
            env_time, raw_time = run_env(), run_raw()
        else:
            raw_time, env_time = run_raw(), run_env()
        pairs.append((env_time, raw_time))
    env.close()
    env_time = median(pair[0] for pair in pairs)
    raw_time = median(pair[1] for pair in pairs)
    print(
        json.dumps(
            {
                "benchmark": "step",
                "env_over_raw": round(median(raw / env for env, raw in pairs), 4),
                "env_steps_per_s": round(steps / env_time),
                "raw_steps_per_s": round(steps / raw_time),
                "overhead_us": round(1e6 * (env_time - raw_time) / steps, 1),
                "physics_steps_per_s": round(sum(map(len, controls)) / raw_time),
                "steps": steps,
                "rounds": options.rounds,
                "same_states": bool(same),
            }
        )
    )


if __name__ == "__main__":
    main(tyro.cli(Options))
