"""A robot between a wall and a post, which tests of planning share."""

from __future__ import annotations

import mujoco
import numpy as np

import rcs
from rcs.kinematics import kinematics_of
from rcs.planning import CollisionChecker, JointLimits, Planner
from rcs.sim import Scene


def make_model() -> tuple[mujoco.MjModel, list[int]]:
    """Return an FR3 at a table with a wall in front of it, and its joints."""
    with rcs.make("Free", robot="fr3") as env:
        robot = env.robots["fr3"]
    scene = Scene.empty()
    scene.add_table()
    scene.add_robot(robot)
    for name, size, pos in [
        ("wall", [0.15, 0.01, 0.14], [0.5, 0.0, 0.14]),
        ("post", [0.03, 0.03, 0.5], [0.1, 0.5, 0.5]),
    ]:
        scene.spec.worldbody.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=pos)
    body = scene.spec.worldbody.add_body(name="stick", pos=[0.4, 0.6, 0.2])
    body.add_freejoint(name="stick")
    body.add_geom(name="stick", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.01, 0.01, 0.10], mass=0.1)
    model = scene.compile()
    return model, [model.joint(robot.prefix + name).id for name in robot.arm.joints]


def make_planner(**options: object) -> Planner:
    """Return a planner in this scene."""
    model, joints = make_model()
    with rcs.make("Free", robot="fr3") as env:
        robot = env.robots["fr3"]
    kinematics = kinematics_of(robot.arm, robot.end_effector)
    return Planner(CollisionChecker(model, [joints]), JointLimits.of(robot.arm), kinematics, **options)


HOME = np.array([0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398])
LEFT, RIGHT = (np.array([side, 0.35, 0.0, -2.0, 0.0, 2.35, 0.785]) for side in (0.45, -0.45))
"""Low on either side of the wall."""
