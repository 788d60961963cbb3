"""Observations of an environment beside positions and frames: torques, wrench, contacts, poses of objects."""

from __future__ import annotations

import warnings
from typing import Any, ClassVar

import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.spaces import flatten, flatten_space
from gymnasium.utils.env_checker import check_env

import rcs
from rcs.devices import ArmState
from rcs.envs.ports.loads import PrivilegedPort
from rcs.envs.ports.port import ArmPort
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.robots.fr3 import FR3
from rcs.tasks import Free, add_box
from rcs.testing.env_contract import EnvContract, require_same_bits

ALL = ("torques", "wrench", "contacts", "privileged")


class TestEverythingObserved(EnvContract):
    """With all observations, an environment keeps its contract."""

    def make_env(self) -> Any:
        return rcs.make("PickCuboid", observe=ALL, max_episode_steps=20)


def test_nothing_more_is_observed_by_default() -> None:
    env: Any = rcs.make("PickCuboid")
    keys = {*env.observation_space.spaces}
    assert keys == {"joints", "joint_velocities", "tquat", "xyzrpy", "gripper"}


def test_keys_follow_the_setup() -> None:
    env: Any = rcs.make("PickCuboid")
    plain = {*env.observation_space.spaces}
    wanted = {
        "torques": {"joint_torques"},
        "wrench": {"tcp_wrench"},
        "contacts": {"finger_contacts", "is_grasped"},
        "privileged": {"privileged"},
    }
    for name, keys in wanted.items():
        env = rcs.make("PickCuboid", observe=(name,))  # pyright: ignore[reportArgumentType]
        assert {*env.observation_space.spaces} == plain | keys
        assert Setup.from_json(env.setup.to_json()) == env.setup


def test_robots_have_their_own_and_the_objects_are_in_the_scene() -> None:
    env: Any = rcs.make("LiftBar", robot="dual_fr3", observe=ALL)
    observation, info = env.reset(seed=0)
    assert {"joint_torques", "tcp_wrench", "finger_contacts", "is_grasped"} < {*observation["left"]}
    np.testing.assert_array_equal(observation["privileged"]["bar"]["tquat"], info["bar_in_scene"])


def test_a_policy_can_be_trained_on_the_state() -> None:
    env: Any = rcs.make("PickCuboid", observe=("contacts", "privileged"), collision_reaction=False)
    flat = flatten_space(env.observation_space)
    assert isinstance(flat, spaces.Box)
    observation, _ = env.reset(seed=0)
    vector: Any = flatten(env.observation_space, observation)
    assert flat.contains(vector.astype(flat.dtype))
    # All that decides the task is in it: where the arm is and how fast, and the same of the cuboid.
    assert vector.size == 7 + 7 + 7 + 6 + 1 + 2 + 1 + 7 + 6


@pytest.mark.parametrize(("task", "name"), [("Place", "mark"), ("Push", "goal")])
def test_a_mark_that_only_the_task_places_is_observed_at_rest(task: str, name: str) -> None:
    envs: Any = rcs.make_vec(task, copies=2, observe=("privileged",))
    seen, _ = envs.reset(seed=0)
    np.testing.assert_array_equal(seen["privileged"][name]["tquat"], envs.simulation.object_poses()[name])
    np.testing.assert_array_equal(seen["privileged"][name]["velocity"], np.zeros((2, 6)))


def test_gymnasiums_checker_finds_nothing() -> None:
    env: Any = rcs.make("PickCuboid", observe=ALL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize(("task", "robot", "name"), [("PickCuboid", "ur5e", "cuboid"), ("PickToy", "fr3", "toy")])
def test_velocities_of_objects_are_the_rates_of_their_poses(task: str, robot: str, name: str) -> None:
    env: Any = rcs.make(task, robot=robot, observe=("privileged",), frequency=500.0, max_episode_steps=None)
    observation, _ = env.reset(seed=0)
    world = env.simulation.world
    random = np.random.default_rng(0)
    model = world.model
    if task == "PickCuboid":
        world.qpos[model.joint(name).qposadr[0] + 2] += 0.3  # in the air
        first = model.joint(name).dofadr[0]
        world.qvel[first : first + 6] = random.uniform(-1.0, 1.0, 6)
    else:
        nodes = np.flatnonzero(model.body_parentid == model.body(name).id)
        places = world.data.xpos[nodes] - world.data.xpos[nodes].mean(axis=0)
        velocities = np.cross([0.0, 0.0, 1.0], places) + random.uniform(-0.2, 0.2, 3)
        for dof, velocity in zip(model.body_dofadr[nodes], velocities, strict=True):
            world.qvel[dof : dof + 3] = velocity
    action = {"joints": np.zeros(env.action_space["joints"].shape), "gripper": np.ones(1, np.float32)}
    before = env.step(action)[0]["privileged"][name]
    observation, *_ = env.step(action)
    after = observation["privileged"][name]
    rate = (after["tquat"][:3] - before["tquat"][:3]) * env.frequency
    np.testing.assert_allclose(after["velocity"][:3], rate, atol=0.02)
    turn = rcs.spatial.compose(
        np.append(np.zeros(3), after["tquat"][3:]), rcs.spatial.inverse(np.append(np.zeros(3), before["tquat"][3:]))
    )
    spin = 2.0 * np.sign(turn[6]) * turn[3:6] * env.frequency
    if task == "PickCuboid":
        assert np.abs(spin).max() > 0.3
        np.testing.assert_allclose(after["velocity"][3:], spin, atol=0.02)
    else:
        np.testing.assert_allclose(after["velocity"][5], spin[2], atol=0.05)


def test_poses_are_those_of_the_task_in_the_base_frame() -> None:
    env: Any = rcs.make("PickCuboid", robot="ur5e", observe=("privileged",))
    observation, info = env.reset(seed=3)
    np.testing.assert_allclose(observation["privileged"]["cuboid"]["tquat"], info["cuboid"], atol=1e-12)
    np.testing.assert_array_equal(observation["privileged"]["cuboid"]["velocity"], np.zeros(6))


@pytest.mark.parametrize("task", ["PickCuboid", "PickToy"])
def test_copies_observe_what_one_environment_observes(task: str) -> None:
    setup = Setup(task=task, observe=ALL)
    single, batch = rcs.make(setup), rcs.make_vec(setup, copies=3, threads=2)
    seen, _ = single.reset(seed=1)
    observation, _ = batch.reset(seed=0)
    batch.action_space.seed(0)
    for _ in range(4):
        require_same_bits({key: _of(observation[key], 1) for key in seen}, seen)
        action = batch.action_space.sample()
        observation, *_ = batch.step(action)
        seen, *_ = single.step({key: value[1] for key, value in action.items()})


def _of(value: Any, copy: int) -> Any:
    return {key: _of(own, copy) for key, own in value.items()} if isinstance(value, dict) else value[copy]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"observe": ("torque",)}, r"observe is .*'torque'.*valid: a sequence, each 'torques', 'wrench'"),
        ({"observe": "torques"}, r"Give a sequence, such as \('torques',\)"),
        ({"observe": ("privileged",), "task": "Free"}, "has no objects to observe"),
        ({"collision_reaction": 1}, "valid: True, False"),
    ],
)
def test_what_cannot_be_observed_is_refused(options: Any, words: str) -> None:
    with pytest.raises(InvalidSetup, match=words):
        rcs.make(Setup(**options))


def test_real_robots_know_no_poses_of_objects_and_no_contacts() -> None:
    for name, words in (("privileged", "in simulation only"), ("contacts", "not measured")):
        with pytest.raises(InvalidSetup, match=words):
            rcs.make("PickCuboid", observe=(name,), hardware="fake")  # pyright: ignore[reportArgumentType]


class Arm:
    """An arm that measures loads, or does not."""

    name = "arm"

    def __init__(self, efforts: list[float], wrench: list[float]) -> None:
        self.limits = FR3_LIMITS
        self._loads = efforts, wrench

    def state(self) -> ArmState:
        efforts, wrench = self._loads
        return ArmState(list(FR3.home), [0.0] * 7, efforts=efforts, wrench=wrench)


class FR3_LIMITS:  # noqa: N801  stands for an object
    joint_lower, joint_upper = FR3.joint_lower, FR3.joint_upper


def test_a_real_arm_gives_what_it_measures() -> None:
    kinematics = kinematics_of(FR3, None)
    arm: Any = Arm([1.0] * 7, [2.0] * 6)
    port = ArmPort(arm, kinematics, observed=("torques", "wrench"), effort=FR3.effort_limit)
    assert {"joint_torques", "tcp_wrench"} < {*port.observation_spaces}
    observation = port.observe()
    np.testing.assert_array_equal(observation["joint_torques"], [1.0] * 7)
    np.testing.assert_array_equal(observation["tcp_wrench"], [2.0] * 6)
    blind: Any = Arm([], [])
    with pytest.raises(InvalidSetup, match="does not measure 'joint_torques'"):
        ArmPort(blind, kinematics, observed=("torques",), effort=FR3.effort_limit).observe()


def test_the_port_of_objects_needs_a_task_with_objects() -> None:
    env: Any = rcs.make("Free")
    with pytest.raises(InvalidSetup, match="has no objects"):
        PrivilegedPort(env.simulation.world, env.simulation.robots, env.simulation.task)


class Blocks(Free):
    """Has a body, and tells the poses that a test wants."""

    told: ClassVar[dict[str, Any]] = {}

    def furnish(self, scene: Any) -> None:
        scene.add_table()
        add_box(scene, "block", (0.5, 0.0), edges=(0.04, 0.04, 0.04), mass=0.05, rgb=(0.8, 0.2, 0.1))

    def objects(self) -> list[str]:
        return ["block"]

    def object_poses(self) -> dict[str, Any]:
        return type(self).told


def test_a_task_that_tells_no_poses_of_its_objects_is_told_how_to() -> None:
    Blocks.told = {}
    with pytest.raises(InvalidSetup, match=r"Blocks.object_poses, which it does not define; it has 'block' in objects"):
        rcs.make(Blocks, observe=("privileged",))
    Blocks.told = {"blok": np.zeros(7)}
    with pytest.raises(InvalidSetup, match=r"names 'blok', and the scene has no body of that name; it has block"):
        rcs.make(Blocks, observe=("privileged",))
    Blocks.told = {"block": np.array([0.5, 0.0, 0.02, 0.0, 0.0, 0.0, 1.0])}
    with rcs.make(Blocks, observe=("privileged",)) as env:
        assert env.reset(seed=0)[0]["privileged"]["block"]["tquat"].shape == (7,)
