"""The first program: an FR3 next to a cuboid on a table, moved for a hundred steps.

One step is 1/30 s of simulated time. An action contains the change of each joint's target and the opening of the
gripper; an observation is a dictionary of arrays. `print(env)` lists the parts of the environment.
"""

from __future__ import annotations

import time

import numpy as np

import rcs

env = rcs.make("PickCuboid", robot="fr3", control="joints", relative=True, frequency=30)
print(env)
print("it takes", env.action_space)

observation, info = env.reset(seed=0)
print("the cuboid lies at", info["cuboid"][:3].round(3), "m in the robot's base frame")
print("the TCP is at     ", observation["tquat"][:3].round(3), "m")

# The first joint turns slowly to and fro, the last one steadily; the gripper closes halfway through.
reward = 0.0
start = time.perf_counter()
for step in range(100):
    difference = np.zeros(7)
    difference[0] = 0.02 * np.cos(2 * np.pi * step / 100)
    difference[6] = -0.01
    action = {"joints": difference, "gripper": np.array([1.0 if step < 50 else 0.0])}
    observation, reward, terminated, truncated, info = env.step(action)
    if terminated or truncated:
        break
seconds = time.perf_counter() - start

print("the TCP came to   ", observation["tquat"][:3].round(3), "m")
print(
    "joints are at     ", observation["joints"].round(2), "rad, the gripper is", observation["gripper"].round(2), "open"
)
print(f"reward {reward:.3f}, success {info['success']}, {100 / 30 / seconds:.0f} times as fast as real time")
env.close()
