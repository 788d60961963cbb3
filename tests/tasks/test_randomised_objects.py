"""Objects of every task vary in size, mass, friction and colour, in one environment as in each copy of a batch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import rcs
from rcs.agents import agent_for
from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.variation.randomiser import Randomiser
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.episode import run_episode
from rcs.rollout.replay import replay
from rcs.sim import Scene, World
from rcs.sim.model_rows import ObjectParts
from rcs.tasks import pick_toy
from rcs.tasks.lift_bar import EDGES, GRASP_AT
from rcs.tasks.pick_toy import MASS, SIZE

Ranges = rcs.Randomisation
TASKS = [("PickCuboid", "fr3"), ("LiftBar", "dual_fr3"), ("PickToy", "xarm7")]
every_task = pytest.mark.parametrize(("task", "robot"), TASKS)
HARDEST = {
    "large and heavy": Ranges.off(object_size=(1.1, 1.1), object_mass=(2.0, 2.0), friction=(0.8, 0.8)),
    "small and heavy": Ranges.off(object_size=(0.9, 0.9), object_mass=(2.0, 2.0), friction=(0.8, 0.8)),
    "large and light": Ranges.off(object_size=(1.1, 1.1), object_mass=(0.5, 0.5), friction=(1.25, 1.25)),
}


def leaves(values: Any, copy: int | None = None) -> list[NDArray[Any]]:
    """Return all arrays of nested dictionaries, or one copy's share of them."""
    if isinstance(values, dict):
        return [leaf for key in sorted(values) if key[0] != "_" for leaf in leaves(values[key], copy)]
    return [np.asarray(values if copy is None else values[copy])]


def require_same(one: Any, many: Any, copy: int) -> None:
    for own, shared in zip(leaves(one), leaves(many, copy), strict=True):
        np.testing.assert_array_equal(own, shared)


def actions_of(envs: Any) -> Any:
    """Small steps of all joints while the end effectors close."""

    def scaled(space: Any) -> Any:
        if hasattr(space, "spaces"):
            return {key: scaled(part) for key, part in space.spaces.items()}
        return np.zeros(space.shape, space.dtype) + space.dtype.type(0.01)

    return scaled(envs.action_space)


def pick(actions: Any, copy: int) -> Any:
    if isinstance(actions, dict):
        return {key: pick(value, copy) for key, value in actions.items()}
    return actions[copy]


@every_task
def test_a_copy_of_a_batch_is_the_single_environment_bit_for_bit(task: str, robot: str) -> None:
    envs = rcs.make_vec(task, robot=robot, copies=3, threads=2, randomisation=True, autoreset="Disabled")
    envs.reset(seed=20)
    actions = actions_of(envs)
    for _ in range(3):
        envs.step(actions)
    mask = np.array([True, False, True])
    _, started = envs.reset(options={"reset_mask": mask})
    steps = [envs.step(actions) for _ in range(12)]
    for copy in range(3):
        single = rcs.make(task, robot=robot, randomisation=True)
        single.reset(seed=20 + copy)
        for _ in range(3):
            single.step(pick(actions, copy))
        if mask[copy]:
            _, told = single.reset()
            require_same(told, started, copy)
        for many, all_rewards, _, _, all_told in steps:
            one, reward, _, _, told = single.step(pick(actions, copy))
            require_same(one, many, copy)
            assert reward == all_rewards[copy]
            for key in single.simulation.task.describe():
                require_same(told[key], all_told[key], copy)
        np.testing.assert_array_equal(single.simulation.world.states(), envs.simulation.world.states()[copy])
        require_same(single.simulation.randomisation, envs.simulation.randomisation, copy)


@every_task
def test_size_mass_friction_and_colour_are_drawn(task: str, robot: str) -> None:
    env = rcs.make(task, robot=robot, randomisation=True)
    (name,) = env.simulation.task.objects()
    world = env.simulation.world
    parts = ObjectParts(world, name)
    soft = len(parts.flexes) > 0
    shape, rows = ("flex", parts.flexes) if soft else ("geom", parts.geoms)
    fields = [f"{shape}_size", f"{shape}_rgba", f"{shape}_friction"]

    def read() -> list[NDArray[Any]]:
        return [getattr(world.model, field)[rows].copy() for field in fields] + [
            world.model.body_mass[parts.bodies].copy()
        ]

    nominal = read()
    _, info = env.reset(seed=1)
    size, rgba, friction, mass = read()
    drawn = {key: values.ravel() for key, values in info["randomisation"].items()}
    np.testing.assert_allclose(size, nominal[0] * drawn["object_size"], rtol=1e-12)
    np.testing.assert_allclose(rgba[0, :3], np.clip(nominal[1][0, :3] + drawn["object_colour"], 0, 1), rtol=1e-6)
    factor = drawn["friction"] * drawn["object_friction"]
    np.testing.assert_allclose(friction, nominal[2] * factor, rtol=1e-12)
    np.testing.assert_allclose(mass, nominal[3] * drawn["object_mass"], rtol=1e-12)


@pytest.mark.parametrize("ranges", HARDEST.values(), ids=HARDEST)
@every_task
def test_the_expert_succeeds_at_the_ends_of_the_ranges(task: str, robot: str, ranges: rcs.Randomisation) -> None:
    setup = rcs.Setup(task=task, robot=robot, randomisation=ranges)
    env = rcs.make(setup)
    assert run_episode(env, agent_for(env), seed=2).success


@pytest.mark.parametrize(("task", "robot"), TASKS[1:])
def test_a_recorded_episode_replays_bit_for_bit(task: str, robot: str, tmp_path: Path) -> None:
    setup = rcs.Setup(task=task, robot=robot, randomisation=rcs.Randomisation())
    for attempt in collect(Collection(setup=setup, out=tmp_path / "varied", episodes=1, seed=3), Progress()):
        assert attempt.result.success
    assert all(result.is_equal for result in replay(tmp_path / "varied"))


@pytest.mark.gl
@every_task
def test_every_copy_is_drawn_as_its_single_environment(task: str, robot: str) -> None:
    view = {"PickCuboid": "side"}.get(task, "front")
    ranges = Ranges.off(object_size=(0.9, 1.1), object_colour=0.2)
    options: dict[str, Any] = {
        "robot": robot,
        "randomisation": ranges,
        "cameras": rcs.Cameras(names=(view,), image_size=64),
    }
    envs, single = rcs.make_vec(task, copies=2, **options), rcs.make(task, **options)
    plain = rcs.make(task, **{**options, "randomisation": None})
    frames = envs.reset(seed=7)[0]["frames"][view]["rgb"]
    for copy in range(2):
        own = single.reset(seed=7 + copy)[0]["frames"][view]["rgb"]
        np.testing.assert_array_equal(own, frames[copy])
        nominal = plain.reset(seed=7 + copy)[0]["frames"][view]["rgb"]
        assert np.abs(own.astype(int) - nominal).max() > 3
    for env in (envs, single, plain):
        env.close()


@pytest.mark.parametrize("copies", [None, 3])
def test_the_bar_lies_on_the_table_and_is_grasped_in_proportion(copies: int | None) -> None:
    options: dict[str, Any] = {"robot": "dual_fr3", "randomisation": Ranges.off(object_size=(0.8, 1.2))}
    env = rcs.make("LiftBar", **options) if copies is None else rcs.make_vec("LiftBar", copies=copies, **options)
    _, info = env.reset(seed=1)
    factor = info["randomisation"]["object_size"][..., 0]
    np.testing.assert_allclose(info["bar_in_scene"][..., 2], factor * EDGES[2] / 2, rtol=1e-12)
    np.testing.assert_allclose(info["grasp_offset"], factor * GRASP_AT * EDGES[1] / 2, rtol=1e-12)


@pytest.mark.parametrize("copies", [None, 3])
def test_a_toy_of_any_size_and_mass_starts_as_it_lies(copies: int | None) -> None:
    options: dict[str, Any] = {
        "robot": "xarm7",
        "randomisation": Ranges.off(object_size=(0.7, 1.3), object_mass=(0.3, 3.0), friction=(0.8, 1.25)),
    }
    env = rcs.make("PickToy", **options) if copies is None else rcs.make_vec("PickToy", copies=copies, **options)
    _, info = env.reset(seed=4)
    drawn = info["randomisation"]
    before, rest_height = info["toy"].copy(), env.simulation.task._rest_height
    # Its bottom is a face, not the end of an ellipsoid, and its weight makes it lower by a fraction of a millimetre.
    np.testing.assert_allclose(before[..., 2], drawn["object_size"][..., 0] * SIZE[2] / 2, atol=4e-3)
    np.testing.assert_allclose(before[..., 2], rest_height, rtol=1e-12)
    action = {key: np.zeros(space.shape, space.dtype) for key, space in env.action_space.spaces.items()}
    action["gripper"][:] = 1.0
    for _ in range(45):
        *_, info = env.step(action)
    np.testing.assert_allclose(info["toy"], before, atol=2e-5)
    assert not np.any(info["is_touched"])
    mass = env.simulation.world.field("body_mass")[..., env.simulation.task._bodies].sum(axis=-1)
    np.testing.assert_allclose(mass, drawn["object_mass"][..., 0] * MASS, rtol=1e-12)


def compiled_toy(monkeypatch: pytest.MonkeyPatch, factor: float) -> mujoco.MjModel:
    """Return a scene with a toy that MuJoCo made `factor` times larger, of the same mass and with the same middle."""
    with monkeypatch.context() as patch:
        patch.setattr(pick_toy, "SIZE", tuple(factor * edge for edge in pick_toy.SIZE))
        patch.setattr(pick_toy, "SKIN", factor * pick_toy.SKIN)
        scene = Scene.empty()
        pick_toy._add_toy(scene.spec, (0.4, 0.1, 0.05), 1.0)
        return scene.compile()


def test_a_larger_toy_is_the_one_that_mujoco_would_make(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = compiled_toy(monkeypatch, 1.2)
    world = World(compiled_toy(monkeypatch, 1.0))
    nominal = world.model.flex_node0.copy()
    Randomiser(world, Ranges.off(object_size=(1.2, 1.2)), objects=["toy"]).begin(EpisodeRandom(0, 0))
    assert not np.allclose(world.model.flex_node0, nominal)
    # Nodes do not turn, so that their inertia counts for nothing; nor does the middle of the carrier, without a mass.
    ignored = {"body_inertia", "body_ipos"}
    for name in dir(expected):
        value = getattr(expected, name)
        if isinstance(value, np.ndarray) and not name.startswith("_") and name not in ignored:
            np.testing.assert_allclose(getattr(world.model, name), value, rtol=1e-9, atol=1e-12, err_msg=name)


def test_soft_bodies_whose_springs_are_along_edges_keep_their_size() -> None:
    spec = Scene.empty().spec
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    for name, dof in (("nodes", "trilinear"), ("edges", "full")):
        carrier = spec.worldbody.add_body(name=name, pos=[0, 0, 1])
        flex = carrier.make_flex(name=name, type="grid", dim=3, dof=dof, count=[3] * 3, spacing=[0.05] * 3, mass=0.1)
        flex.young, flex.poisson, flex.damping = 2e4, 0.3, 2e-3
    world = World(spec.compile())
    parts = {name: ObjectParts(world, name) for name in ("nodes", "edges")}
    assert [part.is_scalable for part in parts.values()] == [True, False]
    assert [part.flexes.tolist() for part in parts.values()] == [[0], [1]]
    assert world.subtree_flags("edges")[world.model.ngeom :].tolist() == [0, 1]


def test_a_toy_is_touched_by_the_hand_and_not_by_being_drawn_out_or_high() -> None:
    setup = rcs.Setup(task="PickToy", robot="xarm7")
    env = rcs.make(setup)
    expert = agent_for(env)
    observation, info = env.reset(seed=0)
    world, task = env.simulation.world, env.simulation.task
    start = world.states()
    moved = world.qpos[task._qpos]
    moved[2::3] += 0.02
    moved[0::3] += 0.01 * np.sign(task._nodes[:, 0])
    action = {key: np.zeros(space.shape, space.dtype) for key, space in env.action_space.spaces.items()}
    action["gripper"][:] = 1.0
    *_, told = env.step(action)
    assert not told["is_touched"]
    observation, info = env.reset(options={"state": start})
    expert.reset(observation, info)
    touched: dict[str, list[bool]] = {}
    is_over = False
    while not is_over:
        observation, _, terminated, truncated, info = env.step(expert.act(observation, info))
        touched.setdefault(expert.phase, []).append(bool(info["is_touched"]))
        is_over = terminated or truncated
    assert not any(touched["approach"])
    assert all(touched["lift"])
    assert all(touched["home"])
