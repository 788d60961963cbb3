"""The guard: no target passes whose way is not free, work stays possible, and whatever goes wrong, nothing moves."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import rcs
from rcs.agents import agent_for
from rcs.envs import Env, Guard
from rcs.envs.gates.guarded_scene import lagging
from rcs.errors import Refused
from rcs.robots.fr3 import FR3
from rcs.sim import Scene
from rcs.tasks.free import Free
from rcs.virtual import StandInArm
from tests.envs.gates.ways import DOWN, HOME, OPEN, ask, lift_above_plate, make_beside_plate


class Plate(Free):
    """A plate of 2 mm beside the hand, between where it is and where it shall be."""

    def furnish(self, scene: Scene) -> None:
        super().furnish(scene)
        table = scene.spec.worldbody.add_body(name="table")
        table.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.6, 0.8, 0.02), pos=(0.3, 0, -0.02))
        plate = scene.spec.worldbody.add_body(name="plate", mocap=True, pos=(0.0, 5.0, 0.0))
        plate.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.15, 0.001, 0.3))


def plate_env(**options: Any) -> Env:
    given = {"relative": False, "max_episode_steps": None, **options}
    return rcs.make(Plate, **given)


def at_plate(env: Env, y: float = 0.15) -> None:
    """Put the plate beside the tool."""
    tool = env.simulation.robots[0].tcp_tquat
    env.simulation.world.data.mocap_pos[0] = (*(tool[:1] + env.robots["fr3"].base_in_scene.translation[0]), y, tool[2])


@pytest.fixture(scope="module")
def sync() -> Iterator[Env]:
    """Return an environment whose motions end at rest, so that ways have no more than what is asked for."""
    with plate_env(stepping="sync", gates=[Guard(touch=())]) as env:
        env.reset(seed=0)
        yield env


def test_a_way_through_a_thin_plate_is_refused_though_both_its_ends_are_free(sync: Env) -> None:
    at_plate(sync)
    here, there = HOME.copy(), HOME + np.array([0.8, 0, 0, 0, 0, 0, 0])
    ask(sync, here, here)
    ask(sync, there, there)
    with pytest.raises(Refused, match=r"geom \d+ of body 'plate'.*keeps 10 mm"):
        ask(sync, here, there)
    sync.simulation.world.data.mocap_pos[0] = (0, 5, 0)
    assert ask(sync, here, there)[""]["joints"] is not None


def test_the_table_the_arm_itself_and_the_other_arm_are_in_the_way() -> None:
    with rcs.make("PickCuboid", relative=False, stepping="sync", gates=["Guard"]) as env:
        env.reset(seed=0)
        down = HOME + DOWN
        with pytest.raises(Refused, match="'table'"):
            ask(env, HOME, down)
        folded = np.array([0.0, -1.7, 0.0, -3.0, 0.0, 0.1, 0.0])
        with pytest.raises(Refused, match=r"'fr3/.*'fr3/"):
            ask(env, HOME, folded)
    with rcs.make("LiftBar", robot="dual_fr3", relative=False, stepping="sync", gates=["Guard"]) as env:
        observation, _ = env.reset(seed=0)
        turned = {
            name: {
                "joints": observation[name]["joints"] + np.array([side * 0.8, 0.3, 0, 0.6, 0, 0, 0]),
                "gripper": OPEN,
            }
            for name, side in (("left", -1.0), ("right", 1.0))
        }
        info = env.step(turned)[-1]
        assert "'left/" in info["refused"]
        assert "'right/" in info["refused"]


def test_the_way_is_checked_from_where_the_arm_is_measured_too(sync: Env) -> None:
    at_plate(sync)
    guard: Any = sync.stack.gates[0]
    beyond = HOME + np.array([0.8, 0, 0, 0, 0, 0, 0])
    sync.simulation.robots[0].put(HOME)
    guard.reset({"": {"joints": HOME}}, ...)  # commanded here, but measured behind the plate
    with pytest.raises(Refused, match="'plate'"):
        guard.admit({"": {"joints": HOME, "gripper": OPEN}}, {"": {"joints": beyond, "gripper": OPEN}})


def test_what_is_in_fast_motion_keeps_the_way_that_it_needs_to_stop() -> None:
    left = []
    for speed in (0.2, 2.0):  # rad/s, towards the plate
        with plate_env(gates=[Guard(touch=())]) as env:
            target = env.reset(seed=0)[0]["joints"]
            at_plate(env, y=0.3)
            info: dict[str, Any] = {}
            while "refused" not in info:
                assert target[0] < 2.0
                target = target + np.array([speed / 30, 0, 0, 0, 0, 0, 0])
                observation, *_, info = env.step({"joints": target, "gripper": OPEN})
            refused_at = observation["joints"][0]
            for _ in range(30):
                observation, *_, info = env.step({"joints": target, "gripper": OPEN})
                assert env.simulation.world.data.ncon == 0
            assert np.abs(observation["joint_velocities"]).max() < 0.3
            left.append(observation["joints"][0] - refused_at)
    assert left[1] > 5 * abs(left[0])
    assert left[1] == pytest.approx(2.0**2 / (2 * 10.0), rel=0.4)  # what braking takes


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_what_is_admitted_touches_nothing_on_its_way_and_what_keeps_the_margin_is_admitted(
    sync: Env, data: st.DataObject
) -> None:
    random = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    world = sync.simulation.world
    model, probe = world.model, mujoco.MjData(world.model)
    lower, upper = np.array(FR3.joint_lower), np.array(FR3.joint_upper)
    start = random.uniform(lower, upper)
    goal = np.clip(start + random.normal(0, 0.25, 7), lower, upper)
    world.data.mocap_pos[0] = random.uniform((-0.2, -0.6, 0.1), (0.6, 0.6, 0.8))
    probe.qpos[:], probe.mocap_pos[:] = world.qpos, world.data.mocap_pos
    moving = model.body_weldid[model.geom_bodyid] > 0
    hand = np.array([model.body(body).name.startswith("fr3/gripper/") for body in model.geom_bodyid])
    table = np.array([model.body(body).name == "table" for body in model.geom_bodyid])
    margins = model.geom_margin.copy()
    least, touches = np.inf, False
    try:
        model.geom_margin[:] = 0.02
        for share in np.linspace(0, 1, 300):
            probe.qpos[:7] = start + share * (goal - start)
            mujoco.mj_kinematics(model, probe)
            mujoco.mj_collision(model, probe)
            geoms, distance = probe.contact.geom, probe.contact.dist
            counts = moving[geoms].any(axis=1)
            work = (hand[geoms].any(axis=1) & table[geoms].any(axis=1))[counts]
            touches |= bool((distance[counts] < 0).any())
            least = min([least, *(distance[counts] + np.where(work, 0.009, 0.0))])
            if share == 0 and least < 0.0101:
                return  # begins too near
    finally:
        model.geom_margin[:] = margins
    if touches:
        with pytest.raises(Refused):
            ask(sync, start, goal)
    elif least > 0.013:
        ask(sync, start, goal)


def test_an_arm_that_is_too_near_may_go_away_and_along_but_no_nearer(sync: Env) -> None:
    at_plate(sync, y=0.0)
    ways = []
    for q in np.linspace(0.2, 0.8, 200):
        guard: Any = sync.stack.gates[0]
        guard._scene.look(0, np.array([q, *HOME[1:], 0.04, 0.04]))
        distance = guard._scene.far.clearance(np.array([q, *HOME[1:], 0.04, 0.04]), 0.01).distance
        if 0.004 < distance < 0.008:
            ways.append(q)
    near = np.array([ways[0], *HOME[1:]])
    towards, away = (near + np.array([d, 0, 0, 0, 0, 0, 0]) for d in (-0.01, 0.01))
    with pytest.raises(Refused, match="'plate'"):
        ask(sync, near, towards)
    ask(sync, near, near)
    ask(sync, near, away)


@pytest.mark.parametrize(
    ("task", "robot"), [("PickCuboid", "fr3"), ("PickCuboid", "so101"), ("PickCuboid", "ur5e"), ("LiftBar", "dual_fr3")]
)
def test_experts_still_do_their_work_under_guard(task: str, robot: str) -> None:
    with rcs.make(task, robot=robot, gates=["Guard"]) as env:
        agent = agent_for(env, None)
        successes = [bool(rcs.run_episode(env, agent, seed=seed).success) for seed in range(3)]
    assert all(successes)


def test_what_a_gripper_holds_is_part_of_the_robot() -> None:
    with make_beside_plate() as env:
        target = lift_above_plate(env)
        world = env.simulation.world
        info: dict[str, Any] = {}
        for _ in range(40):
            target["tquat"][2] -= 0.002
            *_, info = env.step(target)
            if "refused" in info:
                break
        assert "'cuboid'" in info["refused"]
        assert "'plate'" in info["refused"]
        assert world.data.body("cuboid").xpos[2] - 0.5 * info["edges"][2] > world.data.mocap_pos[0][2] + 0.008


def test_what_a_gripper_holds_it_holds_where_its_way_is_cut() -> None:
    with make_beside_plate(on_hit="clip") as env:
        target = lift_above_plate(env)
        fractions = []
        for _ in range(40):
            target["tquat"][2] -= 0.002
            *_, info = env.step(target)
            fractions.append(info["guard_fraction"])
            assert info["is_grasped"]
        assert min(fractions) < 1.0
        world = env.simulation.world
        assert world.data.body("cuboid").xpos[2] - 0.5 * info["edges"][2] > world.data.mocap_pos[0][2] + 0.008


class Post(Free):
    """A thin post between the fingers, where the robot starts."""

    def furnish(self, scene: Scene) -> None:
        super().furnish(scene)
        post = scene.spec.worldbody.add_body(name="post", mocap=True, pos=(0.0, 5.0, 0.0))
        post.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.01, 0.01, 0.02))


def test_fingers_do_not_close_on_what_they_must_not_touch() -> None:
    with rcs.make(Post, relative=False, gates={"Guard": {"on_hit": "clip", "touch": ()}}) as env:
        observation, _ = env.reset(seed=0)
        world = env.simulation.world
        world.data.mocap_pos[0] = world.data.site("fr3/gripper/tcp").xpos
        closed = {"joints": observation["joints"].copy(), "gripper": np.zeros(1, np.float32)}
        for _ in range(20):
            observation, *_, info = env.step(closed)
            assert info["guard_fraction"] < 1.0
            assert world.data.ncon == 0
        assert observation["gripper"] > 0.9


def test_a_real_arm_is_guarded_in_the_scene_that_its_body_is_in() -> None:
    arm = StandInArm(FR3, delay=0.01)
    options: dict[str, Any] = {"relative": False, "frequency": 50, "max_episode_steps": None}
    guard = Guard(deadline=0.5)  # a machine that tests run on may be busy
    with rcs.make("PickCuboid", hardware={"fr3": arm, "fr3/gripper": "fake"}, gates=[guard], **options) as env:
        observation, _ = env.reset(seed=0)
        down = {"joints": observation["joints"] + DOWN, "gripper": OPEN}
        end = time.monotonic() + 10
        info: Mapping[str, Any] = {}
        while "refused" not in info and time.monotonic() < end:
            observation, *_, info = env.step(down)
        assert "'table'" in info["refused"]
        assert not arm.fault
        for _ in range(25):
            observation, *_, info = env.step(down)
        assert observation["tquat"][2] > 0.0


def test_a_rebase_of_one_arm_leaves_what_the_guard_knows_of_the_motion_of_another() -> None:
    hardware = {name: "fake" for arm in ("left", "right") for name in (arm, f"{arm}/gripper")}
    options: dict[str, Any] = {"relative": False, "frequency": 50, "max_episode_steps": None}
    with rcs.make("Free", robot="dual_fr3", hardware=hardware, gates=[Guard(deadline=0.5)], **options) as env:
        observation, _ = env.reset(seed=0)
        target = {arm: {"joints": observation[arm]["joints"].copy(), "gripper": OPEN} for arm in ("left", "right")}
        for _ in range(5):
            target["right"]["joints"][0] += 0.01
            assert "refused" not in env.step(target)[-1]
        guard: Any = env.stack.gates[0]
        commanded, (_, braking) = guard._commanded["right"], guard._motions.ways(0, None)
        assert len(braking) > 2, "it is in motion"
        env.rebase("left")
        np.testing.assert_array_equal(guard._commanded["right"], commanded)
        np.testing.assert_array_equal(guard._motions.ways(0, None)[1], braking)
        env.rebase()
        assert len(guard._motions.ways(0, None)[1]) == 1


@pytest.mark.slow
def test_no_stream_of_far_targets_has_two_arms_touch_anything() -> None:
    """The benchmark judges by the contacts of every physics step; the guard intervenes in half of the episodes."""
    benchmark = Path(__file__).parents[3] / "benchmarks" / "guard_streams.py"
    done = subprocess.run(
        [sys.executable, str(benchmark), "--episodes", "40", "--robot", "dual_fr3"],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = {one["mode"]: one for one in map(json.loads, done.stdout.splitlines())}
    assert found.keys() == {"reject", "clip"}
    for one in found.values():
        assert one["stopped"] >= 10
        assert one["touching"] == 0
        assert one["false_stops"] < 0.01


def test_a_way_begins_where_the_arm_is_and_ends_where_it_is_led() -> None:
    led = np.array([[0.0, 1.0], [0.02, 1.0], [0.04, 1.0], [0.05, 1.0], [0.05, 1.0]])
    here = np.array([-0.004, 1.002])
    way = lagging(led, here)
    assert way[0] == pytest.approx(here)
    assert way[1] == pytest.approx(led[1] + [-0.004, 0.002])  # as fast as at first
    assert way[2] == pytest.approx(led[2] + [-0.002, 0.001])  # half as fast
    assert way[3:] == pytest.approx(led[3:])
    assert lagging(led[-1:], here)[0] == pytest.approx(led[-1])
