"""Plan a motion past obstacles, time it, and execute it; then pick the cuboid between the posts."""

from __future__ import annotations

import numpy as np

import rcs
from rcs.agents import agent_for
from rcs.envs import planner_for

env = rcs.make(
    "PickCuboid", robot="fr3", control="joints", relative=False, task_options={"obstacles": 4}, max_episode_steps=None
)
with env:
    observation, info = env.reset(seed=3)

    # The planner copies the present scene: the posts, the cuboid and the table.
    planner = planner_for(env, margin=0.01, speed=0.4)
    home = observation["joints"].astype(float)
    x, y, z = info["cuboid"][:3]
    above = rcs.Pose.from_rpy((x, y, z + 0.15), (np.pi, 0.0, 0.0))
    path = planner.plan(home, above, seed=1)
    timed = planner.time(path)
    print(f"a path of {len(path.waypoints)} waypoints, {path.length:.2f} rad, takes {timed.duration:.2f} s")

    # No joint exceeds its limits at any time.
    samples = timed.sampled(1000.0)
    for name, values, limit in [
        ("speed", samples.velocities, planner.limits.velocity),
        ("acceleration", samples.accelerations, planner.limits.acceleration),
        ("jerk", samples.jerks, planner.limits.jerk),
    ]:
        print(f"  {name} up to {100 * np.abs(values / limit).max():.0f} % of the limits")

    # Follow it: one target per step.
    targets = timed.sampled(env.frequency).positions
    for target in [*targets, *targets[-1:].repeat(20, axis=0)]:
        observation, *_, info = env.step({"joints": target, "gripper": np.ones(1, np.float32)})
    print(f"  ends {np.abs(observation['joints'] - path.waypoints[-1]).max():.3f} rad from its goal")

    # An agent that plans, grasps and lifts.
    agent = agent_for(env, "planner")
    result = rcs.run_episode(env, agent, seed=3, max_steps=400)
    print(f"picked between the posts: {result.success} after {result.steps} steps")
