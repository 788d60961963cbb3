"""Objects that do not count as held: thrown, balanced, standing on something, lifted at one end, and never touched."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

import rcs
from rcs.agents import agent_for
from rcs.envs.assemble import assemble
from rcs.kinematics import kinematics_of
from rcs.setups.make import resolve
from rcs.spatial import Pose
from rcs.tasks import HoldTimer, PickCuboid

HOME = np.array([0.3069, 0.0, 0.4869])
"""Where the TCP of an FR3 is at home [m]."""


def closing(env: Any, opening: float = 0.0) -> dict[str, Any]:
    action = {key: np.zeros(space.shape, space.dtype) for key, space in env.action_space.spaces.items()}
    action["gripper"][:] = opening
    return action


def results(env: Any, seconds: float, opening: float = 0.0) -> list[dict[str, Any]]:
    """Return the infos of steps in which the arm stays where it is."""
    infos = []
    while not infos or infos[-1]["time"] < seconds:
        *_, terminated, _, info = env.step(closing(env, opening))
        infos.append(info)
        if terminated:
            break
    return infos


@pytest.mark.parametrize(
    ("stepping", "frequency"), [("async", 10.0), ("async", 100.0), ("sync", 30.0), ("sync", 100.0)]
)
def test_a_hold_of_one_second_lasts_one_second_however_the_world_is_stepped(stepping: Any, frequency: float) -> None:
    env = rcs.make("PickCuboid", stepping=stepping, frequency=frequency, max_episode_steps=None)
    expert = agent_for(env)
    observation, info = env.reset(seed=1)
    expert.reset(observation, info)
    since, is_over = None, False
    while not is_over:
        observation, _, is_over, _, info = env.step(expert.act(observation, info))
        is_held = info["is_grasped"] and info["cuboid"][2] - 0.0288 >= 0.10
        since = None if not is_held else info["time"] if since is None else since
    assert info["success"]
    assert since is not None
    assert info["time"] - since >= 1.0 - 1e-6


def test_a_timer_starts_anew_when_a_place_moves_too_far() -> None:
    world = rcs.make("Free").simulation.world
    timer = HoldTimer(world, 1.0, 0.01, places=1)
    yes, ends = np.True_, []
    for step in range(40):
        world.time[...] = 0.1 * step
        place = np.array([[0.0, 0.0, 0.02 if step >= 5 else 0.001 * step]])
        ends.append(bool(timer.count(yes, place)))
    assert ends.index(True) == 15
    assert not timer.count(np.False_, np.zeros((1, 3)))
    assert not timer.count(yes, np.zeros((1, 3)))


def test_a_cuboid_that_is_thrown_up_is_not_held() -> None:
    env = rcs.make("PickCuboid", task_options={"hold_time": 0.1})
    env.reset(seed=0)
    world = env.simulation.world
    first = int(world.model.joint("cuboid").dofadr[0])
    world.qvel[first + 2] = 4.0
    infos = results(env, 1.5, opening=1.0)
    assert max(info["cuboid"][2] for info in infos) > 0.5
    assert not any(info["success"] for info in infos)


class PickFromShelf(PickCuboid):
    """The cuboid stands on a shelf between the open fingers of an FR3 at home."""

    def furnish(self, scene: Any) -> None:
        super().furnish(scene)
        top = HOME[2] - 0.0288
        size = [0.05, 0.01, top / 2]
        scene.spec.worldbody.add_geom(
            name="shelf", type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=[HOME[0], 0.0, top / 2]
        )


def on_the_shelf() -> Any:
    parts = resolve(rcs.Setup(task="PickCuboid", control="tquat", max_episode_steps=None))
    env = assemble(replace(parts, task=PickFromShelf(parts.task.area)))
    env.reset(seed=0, options={"objects": {"cuboid": np.array([*HOME, 0.0, 0.0, 0.0, 1.0])}})
    return env


def test_a_cuboid_that_is_grasped_but_stands_on_something_is_not_held() -> None:
    env = on_the_shelf()
    still = {"tquat": np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), "gripper": np.zeros(1, np.float32)}
    infos = [env.step(still)[-1] for _ in range(75)]
    assert all(info["is_grasped"] for info in infos[-30:])
    assert infos[-1]["cuboid"][2] > 0.4
    assert not any(info["success"] for info in infos)
    up = {**still, "tquat": np.array([0.0, 0.0, 0.005, 0.0, 0.0, 0.0, 1.0])}
    for step in range(60):
        *_, terminated, _, info = env.step(up if step < 10 else still)
        if terminated:
            break
    assert info["success"], "it is once it has been lifted off"


@pytest.mark.parametrize("factor", [1.0, 20.0])
def test_a_cuboid_that_lies_on_closed_fingers_is_not_grasped_however_heavy_it_is(factor: float) -> None:
    env = rcs.make("PickCuboid", max_episode_steps=None)
    (robot,) = env.robots.values()
    joints = np.array(robot.arm.home)
    joints[5] += np.pi / 2  # the fingers point forward, side by side
    tcp = kinematics_of(robot.arm, robot.end_effector).forward(joints)
    assert abs(tcp.matrix[2, 1]) < 1e-6
    world = env.simulation.world
    world.model.body("cuboid").mass[:] *= factor
    # Their tops are 9 mm above the TCP.
    pose = Pose(tcp.translation + [0.0, 0.0, 0.0092 + 0.0288], (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)))
    env.reset(
        options={"robot": {"joints": joints, "gripper": np.zeros(1, np.float32)}, "objects": {"cuboid": pose.tquat}}
    )
    infos = results(env, 0.5)
    assert infos[-1]["cuboid"][2] > pose.translation[2] - 0.01, "it lies there"
    assert not any(info["is_grasped"] or info["success"] for info in infos)


@pytest.mark.parametrize(("tilt", "height", "is_success"), [(8.0, 0.14, False), (8.0, 0.18, True), (0.0, 0.14, True)])
def test_both_ends_of_the_bar_must_be_high(tilt: float, height: float, is_success: bool, monkeypatch: Any) -> None:
    env = rcs.make("LiftBar", robot="dual_fr3")
    pose = Pose.from_rpy((0.5, 0.0, height), (np.deg2rad(tilt), 0.0, 0.0)).tquat
    env.reset(seed=0)
    task, world = env.simulation.task, env.simulation.world
    task.place({"bar": pose}, ...)
    world.refresh()
    monkeypatch.setattr(task._grip, "grasps", lambda: np.ones(2, np.bool_))
    assert not task.evaluate().info["success"]
    world.time[...] = 1.1
    assert task.evaluate().info["success"] == is_success


def test_a_toy_at_home_that_nobody_touches_is_not_held() -> None:
    env = rcs.make("PickToy", robot="xarm7", max_episode_steps=None)
    env.reset(seed=0)
    world, task = env.simulation.world, env.simulation.task
    nodes = world.qpos[task._qpos].copy()
    nodes[2::3] += 0.3
    for _ in range(40):
        world.qpos[task._qpos] = nodes
        world.qvel[:] = 0.0
        *_, terminated, _, info = env.step(closing(env, 1.0))
        assert not terminated
        assert not info["success"]
    assert info["toy"][2] > 0.2
