"""What an environment costs on top of its physics: `env.step` against MuJoCo's own `mj_step` with the same controls.

Both run the same episode, a scripted pick of the cuboid, from the same state with the same controls and the same number
of physics steps; the states at the end are compared. Rounds of the two alternate, and the ratio is the median over
rounds.

Prints one JSON object: `env_over_raw` (environment steps/s over raw), `env_steps_per_s`, `raw_steps_per_s`.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from statistics import median

import mujoco
import numpy as np
import tyro

import rcs
from rcs.agents import agent_for


@dataclass(kw_only=True)
class Options:
    """What to measure."""

    rounds: int = 41
    """Alternating rounds of one episode each."""
    seed: int = 0
    """Of the episode."""


def main(options: Options) -> None:
    """Measure and print."""
    setup = rcs.Setup()
    env = rcs.make(setup)
    world = env.scenario.world
    expert = agent_for(env)
    observation, info = env.reset(seed=options.seed)
    expert.reset(observation, info)
    start = world.states().copy()
    actions, controls, substeps = [], [], []
    is_over = False
    while not is_over:
        action = expert.act(observation, info)
        observation, _, terminated, truncated, info = env.step(action)
        actions.append(action)
        controls.append(world.ctrl.copy())
        substeps.append(int(world.core.substeps[0]))
        is_over = terminated or truncated
    final = world.states().copy()
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
        for control, count in zip(controls, substeps, strict=True):
            data.ctrl[:] = control
            mujoco.mj_step(model, data, count)
        return time.perf_counter() - begin

    run_env()
    same = np.array_equal(world.states(), final)
    run_raw()
    same = same and np.array_equal(world.states(), final)
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
                "physics_steps_per_s": round(sum(substeps) / raw_time),
                "steps": steps,
                "rounds": options.rounds,
                "same_states": bool(same),
            }
        )
    )


if __name__ == "__main__":
    main(tyro.cli(Options))
