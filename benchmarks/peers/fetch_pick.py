"""FetchPickAndPlaceDense of Gymnasium-Robotics, two processes: `fetch_pick.py SIZE`, with a camera if SIZE is not 0."""

from __future__ import annotations

import sys

import gymnasium
import gymnasium_robotics
from rate import report

PROCESSES = 2


def make() -> gymnasium.Env:
    """Return one environment, with its picture as observation where wanted."""
    gymnasium.register_envs(gymnasium_robotics)
    size = int(sys.argv[1])
    if not size:
        return gymnasium.make("FetchPickAndPlaceDense-v4")
    env = gymnasium.make("FetchPickAndPlaceDense-v4", render_mode="rgb_array", width=size, height=size)
    return gymnasium.wrappers.AddRenderObservation(env)


def main() -> None:
    """Measure and print."""
    one = make()
    core = one.unwrapped
    period, physics = float(core.dt), float(core.model.opt.timestep)
    one.close()
    envs = gymnasium.vector.AsyncVectorEnv([make] * PROCESSES, context="spawn")
    envs.reset(seed=0)
    envs.action_space.seed(0)
    report(
        lambda: envs.step(envs.action_space.sample()),
        copies=PROCESSES,
        control_period=period,
        physics_step=physics,
        pixels=int(sys.argv[1]),
    )
    envs.close()


if __name__ == "__main__":
    main()
