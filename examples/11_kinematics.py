"""Inverse kinematics: a pose, another elbow angle at the same pose, and a circle by velocities of the TCP.

`kinematics_of` makes the kinematics of any robot from its description. In an environment, control by `twist` uses the
same solver: its actions are velocities of the TCP, here the tangent of a circle plus a correction of the error.
"""

from __future__ import annotations

import numpy as np

import rcs
from rcs.kinematics import Elbow, IkStatus, kinematics_of
from rcs.spatial import Pose

RADIUS = 0.08
SPEED = 0.1

with rcs.make("Free", robot="fr3", control="twist", frequency=50, max_episode_steps=None) as env:
    robot = env.robots["fr3"]
    kinematics = kinematics_of(robot.arm, robot.end_effector)
    home = np.array(robot.arm.home)
    pose = kinematics.forward(home)

    # A pose 10 cm to the left; the result includes its errors.
    left = Pose(pose.translation + [0.0, 0.1, 0.0], pose.quaternion)
    found = kinematics.inverse(left, home)
    print(f"{found.status.name}, {1e3 * found.translation_error:.3f} mm off, joints {np.round(found.joints, 3)}")

    # The same pose with the elbow down to the side.
    aside = Elbow(kinematics).to(found.joints, 0.7)
    assert aside.status == IkStatus.ok
    moved = np.abs(aside.joints - found.joints).max()
    print(
        f"elbow 0.7 rad to the side: joints move by up to {moved:.2f} rad, the TCP by {aside.translation_error:.1e} m"
    )

    # Out of reach: without best effort, the result has the initial joints and a status.
    print(f"a pose 3 m away: {kinematics.inverse(Pose([3.0, 0.0, 0.5]), home).status.name}")

    # One lap of a circle, by velocities.
    observation, _ = env.reset(seed=0, options={"robot": {"joints": home}})
    center = observation["tquat"][:3] - [RADIUS, 0.0, 0.0]
    steps = round(2 * np.pi * RADIUS / SPEED * env.frequency)
    errors = []
    for angle in 2 * np.pi * np.arange(steps) / steps:
        radial, tangent = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle), 0.0])
        off = center + RADIUS * radial - observation["tquat"][:3]
        twist = np.concatenate([SPEED * tangent + 2.0 * off, np.zeros(3)])
        observation, *_ = env.step({"twist": twist, "gripper": np.ones(1, np.float32)})
        errors.append(abs(np.linalg.norm(observation["tquat"][:2] - center[:2]) - RADIUS))
    print(f"a circle of {100 * RADIUS:.0f} cm in {steps} steps: at most {1e3 * max(errors):.1f} mm off")
