"""Lift of robosuite with a Panda, two processes: `robosuite_lift.py SIZE`, with a camera if SIZE is not 0."""

from __future__ import annotations

import sys

import gymnasium
import robosuite
from rate import report
from robosuite.wrappers import GymWrapper

PROCESSES = 2
CONTROL_HZ = 20


def make() -> gymnasium.Env:
    """Return one environment."""
    size = int(sys.argv[1])
    look = {"camera_names": "agentview", "camera_heights": size, "camera_widths": size} if size else {}
    env = robosuite.make(
        "Lift",
        robots="Panda",
        has_renderer=False,
        has_offscreen_renderer=bool(size),
        use_camera_obs=bool(size),
        reward_shaping=True,
        control_freq=CONTROL_HZ,
        horizon=200,
        **look,
    )
    wrapped = GymWrapper(env, keys=["robot0_proprio-state", "agentview_image" if size else "object-state"])
    wrapped.metadata = {}  # it has None, which vectors of Gymnasium refuse
    return wrapped


def main() -> None:
    """Measure and print."""
    one = make()
    physics = float(one.env.model_timestep)
    one.close()
    envs = gymnasium.vector.AsyncVectorEnv([make] * PROCESSES, context="spawn")
    envs.reset(seed=0)
    envs.action_space.seed(0)
    report(
        lambda: envs.step(envs.action_space.sample()),
        copies=PROCESSES,
        control_period=1 / CONTROL_HZ,
        physics_step=physics,
        pixels=int(sys.argv[1]),
    )
    envs.close()


if __name__ == "__main__":
    main()
