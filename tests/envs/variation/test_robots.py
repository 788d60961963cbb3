"""Variations of robots and of their timing act, by as much as was given."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

import rcs
from rcs.sim.randomisation import Randomisation

OPEN = np.ones(1, np.float32)
STEPS_OF_PHYSICS = {"frequency": 500, "control": "joints", "relative": False, "binary_gripper": False}


def make(robot: str = "fr3", task: str = "Free", options: dict[str, Any] | None = None, **ranges: Any) -> Any:
    return rcs.make(task, robot=robot, randomisation=Randomisation.off(**ranges), **(options or {}))


def home_of(env: Any) -> np.ndarray:
    return np.array(next(iter(env.robots.values())).arm.home)


def deflection(factor: float) -> float:
    """Return by how much a torque on the first joint turns it [rad]."""
    env = make(servo_stiffness=(factor, factor))
    env.reset(seed=0)
    model, data = env.simulation.world.model, env.simulation.world.data
    data.qfrc_applied[0] = 5.0
    before = data.qpos[0]
    mujoco.mj_step(model, data, nstep=1500)
    return float(data.qpos[0] - before)


def test_a_stiffer_servo_gives_in_less_by_the_factor_that_was_drawn() -> None:
    assert deflection(0.8) / deflection(1.25) == pytest.approx(1.25 / 0.8, rel=1e-3)


def test_a_servo_with_more_damping_follows_a_step_of_its_target_later() -> None:
    moved = []
    for factor in (0.8, 1.25):
        env = make(servo_damping=(factor, factor))
        env.reset(seed=0)
        model, data = env.simulation.world.model, env.simulation.world.data
        before = data.qpos[0]
        data.ctrl[0] += 0.01
        mujoco.mj_step(model, data, nstep=50)
        moved.append(data.qpos[0] - before)
    assert 0.001 < moved[1] < 0.9 * moved[0]


def held_cuboid(robot: str, **ranges: Any) -> tuple[Any, float]:
    """Close a gripper on a cuboid without gravity; return the environment and the force between the two jaws [N]."""
    env = make(robot, "PickCuboid", {"stepping": "async"}, **ranges)
    observation, _ = env.reset(seed=0)
    env.reset(seed=0, options={"objects": {"cuboid": observation["tquat"]}})
    world = env.simulation.world
    world.model.opt.gravity[:] = 0.0
    for _ in range(40):
        env.step({"joints": np.zeros(len(home_of(env))), "gripper": np.zeros(1, np.float32)})
    cuboid, force = world.model.geom("cuboid").id, np.zeros(6)
    total = 0.0
    for i in range(world.data.ncon):
        if cuboid in world.data.contact.geom[i]:
            mujoco.mj_contactForce(world.model, world.data, i, force)
            total += force[0]
    return env, total / 2


@pytest.mark.parametrize("robot", ["fr3", "ur5e", "so101"])
def test_a_gripper_grips_with_the_share_of_its_force_that_was_drawn(robot: str) -> None:
    weak, strong = (held_cuboid(robot, gripper_force=(factor, factor))[1] for factor in (0.8, 1.2))
    assert strong / weak == pytest.approx(1.5, rel=0.1)


@pytest.mark.parametrize("field", ["friction", "object_friction"])
def test_a_pulled_object_slips_or_holds_as_the_friction_that_was_drawn_says(field: str) -> None:
    env, grip = held_cuboid("fr3")
    coefficient = float(env.simulation.world.model.geom("cuboid").friction[0])
    pull = 2.0 * grip * coefficient
    for factor, slips in ((0.9, True), (1.15, False)):
        env, _ = held_cuboid("fr3", **{field: (factor, factor)})
        model, data = env.simulation.world.model, env.simulation.world.data
        body, hand = model.body("cuboid").id, model.body("fr3/gripper/hand").id
        before = data.xpos[body] - data.xpos[hand]
        data.xfrc_applied[body, 2] = -pull
        mujoco.mj_step(model, data, nstep=50)
        after = data.xpos[body] - data.xpos[hand]
        assert (np.linalg.norm(after - before) > 0.02) == slips


@pytest.mark.parametrize(("task", "robot"), [("PickCuboid", "so101"), ("PickToy", "xarm7"), ("LiftBar", "dual_fr3")])
def test_objects_rest_on_a_table_of_any_height_and_cameras_stay(task: str, robot: str) -> None:
    for height in (-0.03, 0.03):
        ranges = Randomisation.off(table_height=0.03)
        env = rcs.make(task, robot=robot, randomisation=ranges)
        plain = rcs.make(task, robot=robot)
        # The seed of which the height is near an end of the range.
        seed = next(s for s in range(100) if drawn_height(env, s) * np.sign(height) > 0.025)
        plain.reset(seed=seed)
        (at,), (usual,) = env.simulation.object_poses().values(), plain.simulation.object_poses().values()
        np.testing.assert_allclose(at - usual, [0, 0, drawn_height(env, seed), 0, 0, 0, 0], atol=1e-12)
        world = env.simulation.world
        for _ in range(10):
            world.core.advance()
        (rested,) = env.simulation.object_poses().values()
        np.testing.assert_allclose(rested[:3], at[:3], atol=1e-3)
        np.testing.assert_array_equal(world.model.cam_pos, plain.simulation.world.model.cam_pos)


def drawn_height(env: Any, seed: int) -> float:
    return float(env.reset(seed=seed)[1]["randomisation"]["table_height"][0])


@pytest.mark.parametrize("robot", ["fr3", "so101"])
def test_a_response_comes_later_by_exactly_the_latency_that_is_told(robot: str) -> None:
    late = make(robot, options=STEPS_OF_PHYSICS, action_latency=(0.01, 0.05))
    plain = make(robot, options=STEPS_OF_PHYSICS)
    told = set()
    for seed in range(3):
        histories = []
        for env in (plain, late):
            observation, info = env.reset(seed=seed)
            target = observation["joints"].copy()
            seen = []
            for k in range(60):
                opening = OPEN
                if k >= 5:
                    target = target + 0.001
                    opening = 0.5 * OPEN
                observation, *_ = env.step({"joints": target, "gripper": opening})
                seen.append(np.append(observation["joints"], observation["gripper"]))
            histories.append(np.array(seen))
        latency = info["randomisation"]["action_latency"].item()
        steps = round(latency / 0.002)
        assert steps > 0
        assert latency == pytest.approx(0.002 * steps, abs=1e-12)
        told.add(steps)
        first, second = histories
        assert np.abs(first[-1] - first[0]).min() > 1e-4
        errors = {shift: np.abs(second[shift:] - first[: 60 - shift]).max() for shift in (steps - 1, steps, steps + 1)}
        assert errors[steps] < 0.1 * min(errors[steps - 1], errors[steps + 1])
    assert len(told) > 1


def test_robots_start_around_home_and_stay_there_whatever_the_latency() -> None:
    most = 0.2
    envs = rcs.make_vec(
        "PickCuboid",
        copies=32,
        threads=1,
        randomisation=Randomisation.off(robot_start=most, gripper_opening=(0.2, 0.9), action_latency=(0.0, 0.05)),
    )
    observation, info = envs.reset(seed=0)
    drawn = info["randomisation"]
    deviation = observation["joints"] - np.array(envs.robots["fr3"].arm.home)
    np.testing.assert_allclose(deviation, drawn["robot_start"], atol=1e-12)
    np.testing.assert_allclose(observation["gripper"], drawn["gripper_opening"], atol=1e-6)
    assert np.abs(deviation).max() <= most
    assert np.abs(deviation).max(axis=0).min() > 0.7 * most
    assert (deviation.min(axis=0) < -0.5 * most).all()
    action = {"joints": np.zeros((32, 7)), "gripper": np.ones((32, 1), np.float32)}
    for _ in range(5):
        stayed, *_ = envs.step(action)
    np.testing.assert_allclose(stayed["joints"], observation["joints"], atol=1e-3)


@pytest.mark.parametrize("robot", ["fr3", "ur5e", "so101", "dual_fr3"])
def test_no_robot_starts_in_a_collision_or_outside_of_its_limits(robot: str) -> None:
    env = make(robot, robot_start=0.5)
    world = env.simulation.world
    for seed in range(40):
        env.reset(seed=seed)
        mujoco.mj_forward(world.model, world.data)
        assert not (world.data.contact.dist < 0.0).any()
        for one in env.simulation.robots:
            arm = one.placement.arm
            assert (one.joints >= np.array(arm.joint_lower) - 1e-12).all()
            assert (one.joints <= np.array(arm.joint_upper) + 1e-12).all()


def test_a_start_that_always_collides_is_home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.envs.variation.robots._FreeSpace._touching", lambda *_: frozenset({(1, 2)}))
    env = make(robot_start=0.1)
    monkeypatch.setattr("rcs.envs.variation.robots._FreeSpace._touching", lambda *_: frozenset({(3, 4)}))
    observation, info = env.reset(seed=0)
    np.testing.assert_array_equal(info["randomisation"]["robot_start"], np.zeros(7))
    np.testing.assert_allclose(observation["joints"], home_of(env))


def test_a_synchronous_step_waits_for_a_gripper_that_gets_its_action_late() -> None:
    env = make("fr3", options={"stepping": "sync"}, action_latency=(0.2, 0.2))
    env.reset(seed=0)
    for opening in (0.0, 1.0, 1.0, 0.0):
        observation, *_ = env.step({"joints": np.zeros(7), "gripper": np.full(1, opening, np.float32)})
        assert abs(observation["gripper"].item() - opening) < 0.05
