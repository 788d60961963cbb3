"""A guard between a program and its robots refuses or clips colliding motions before they reach a device."""

from __future__ import annotations

import mujoco
import numpy as np

import rcs
from rcs.agents import PickExpert
from rcs.envs import Guard
from rcs.sim import Scene
from rcs.tasks import Free


class Shelf(Free):
    """A thin shelf beside the arm."""

    def furnish(self, scene: Scene) -> None:
        """Add it to the scene."""
        super().furnish(scene)
        shelf = scene.spec.worldbody.add_body(name="shelf", pos=[0.0, 0.25, 0.45])
        shelf.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.2, 0.001, 0.3])


GRIPPER = np.ones(1, np.float32)

# The goal behind the shelf is free, but the path leads through it. Checking only the ends would miss that.
for on_hit in ("reject", "clip", "stop"):
    with rcs.make(Shelf, relative=False, frequency=10, gates={"Guard": {"on_hit": on_hit}}) as env:
        observation, _ = env.reset(seed=0)
        goal = observation["joints"] + np.array([1.5, 0, 0, 0, 0, 0, 0])
        truncated, told, steps = False, "", 0
        while not told and steps < 40:
            observation, _, _, truncated, info = env.step({"joints": goal, "gripper": GRIPPER})
            steps += 1
            told = info.get("refused", "")
            if info["guard_fraction"] == 0 and not told:
                told = "no part of the motion is free"
        turned = observation["joints"][0]
        print(f"{on_hit:6}: after {steps} steps, turned by {turned:.2f} rad, truncated {truncated}: {told}")

# The task remains possible: the gripper may touch its object and come close to the table.
with rcs.make("PickCuboid", gates=[Guard(margin=0.01)]) as env:
    print(env.limits())
    expert = PickExpert(env)
    results = [rcs.run_episode(env, expert, seed=seed) for seed in range(3)]
    print("successes under guard:", sum(bool(result.success) for result in results), "of", len(results))
