"""Control modes are layers: the same motion commanded by joints, as a pose, and as a pose difference.

A layer maps actions down and observations up. `control` and `relative` select the layers between an action and the
robot; the robot below them, and the content of observations, stay the same.
"""

from __future__ import annotations

import numpy as np

import rcs

UP = 0.10  # m
STEPS = 40
# The way up takes 30 steps; in the rest the servos, which lag by about a tenth of a second, catch up.
PARTS = np.minimum(np.arange(1, STEPS + 1) / 30, 1.0)

# Absolute joints: the lowest level. Targets come from the kinematics here, as a planner would give them.
env = rcs.make("Free", control="joints", relative=False)
observation, info = env.reset(seed=0)
home = observation["tquat"]
print(env)

# Absolute poses: inverse kinematics is a layer. `tquat` is a translation [m] and a quaternion xyzw, in the base frame.
env_tquat = rcs.make("Free", control="tquat", relative=False)
observation, info = env_tquat.reset(seed=0)
for part in PARTS:
    pose = home.copy()
    pose[2] += UP * part
    action = {"tquat": pose, "gripper": np.array([1.0])}
    observation, reward, terminated, truncated, info = env_tquat.step(action)
print(env_tquat)
print(f"tquat, absolute:   rose by {observation['tquat'][2] - home[2]:.3f} m; IK status {info['ik_status']}")

# The same joints, sent to the joint environment, lead to the same place.
targets = observation["joints"]
start = env.reset(seed=0)[0]["joints"]
for part in PARTS:
    action = {"joints": start + (targets - start) * part, "gripper": np.array([1.0])}
    observation, reward, terminated, truncated, info = env.step(action)
print(f"joints, absolute:  rose by {observation['tquat'][2] - home[2]:.3f} m; cut by LimitStep: {info['is_limited']}")

# Differences to the last target, as from teleoperation or a policy. Roll, pitch, yaw are in rad.
env_relative = rcs.make("Free", control="xyzrpy", relative=True)
observation, info = env_relative.reset(seed=0)
for rise in UP * np.diff(PARTS, prepend=0.0):
    action = {"xyzrpy": np.array([0.0, 0.0, rise, 0.0, 0.0, 0.0]), "gripper": np.array([1.0])}
    observation, reward, terminated, truncated, info = env_relative.step(action)
print(env_relative)
print(f"xyzrpy, relative:  rose by {observation['tquat'][2] - home[2]:.3f} m")

# Every action is checked before it reaches a device.
try:
    env_relative.step({"xyzrpy": np.array([0.0, 0.0, np.nan, 0.0, 0.0, 0.0]), "gripper": np.array([1.0])})
except rcs.errors.InvalidAction as err:
    print("refused:", err)

for each in (env, env_tquat, env_relative):
    each.close()
