"""Many copies of one environment, stepped together on native threads: one action array in, one observation array out.

It is a `gymnasium.vector.VectorEnv`. The layers are those of a single environment, with an additional leading axis of
every array. Copy i equals a single environment with seed + i, bit for bit, for any number of threads.
"""

from __future__ import annotations

import time

import numpy as np

import rcs

COPIES = 24
STEPS = 60

envs = rcs.make_vec("PickCuboid", copies=COPIES, robot="fr3", control="joints", relative=True)
observations, infos = envs.reset(seed=10)
print(envs)
print("joints", observations["joints"].shape, "cuboids", infos["cuboid"].shape)

# The same action for all, scaled by the number of the copy.
scale = np.linspace(-1.0, 1.0, COPIES)[:, None]
difference = np.zeros((COPIES, 7))
difference[:, [0, 3]] = 0.02 * scale
actions = {"joints": difference, "gripper": np.ones((COPIES, 1), np.float32)}

rewards = np.zeros(COPIES)
start = time.perf_counter()
for _ in range(STEPS):
    observations, rewards, terminated, truncated, infos = envs.step(actions)
seconds = time.perf_counter() - start
print(f"{COPIES * STEPS} steps in {seconds:.2f} s: {COPIES * STEPS / seconds:.0f} steps/s")

# One environment, seeded like copy 7, ends in the same state.
env = rcs.make("PickCuboid", robot="fr3", control="joints", relative=True)
observation, info = env.reset(seed=17)
reward = 0.0
action = {key: values[7] for key, values in actions.items()}
for _ in range(STEPS):
    observation, reward, *_ = env.step(action)
same = all(np.array_equal(observation[key], observations[key][7]) for key in observation) and reward == rewards[7]
print("copy 7 equals a single environment, bit for bit:", same)

env.close()
envs.close()
