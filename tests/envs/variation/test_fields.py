"""Any field of the model varies by its name: with the seed, per copy, and the same again in a replay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import rcs
from rcs import FieldRange, Randomisation
from rcs.envs import EpisodeRandom
from rcs.envs.variation.randomiser import Randomiser
from rcs.errors import InvalidSetup
from rcs.rollout.replay import replay
from rcs.sim import Scene, World
from rcs.sim.model_fields import variable_fields

RANGES = Randomisation.off(
    fields=(
        FieldRange("geom_friction", 0.3, 1.2, names="cuboid*", operation="set", axes=(0,)),
        FieldRange("dof_armature", 0.5, 2.0, names="fr3/*", per="element"),
        FieldRange("geom_size", 0.9, 1.1, names="cuboid", per="all"),
        FieldRange("geom_rgba", -0.2, 0.2, names="table*", operation="add", axes=(0, 1, 2)),
    )
)
KEYS = ["geom_friction[cuboid*, 0]", "dof_armature[fr3/*]", "geom_size[cuboid]", "geom_rgba[table*, 0, 1, 2]"]
ROBOT = slice(6, 15)
"""Degrees of freedom of the arm and its fingers, after those of the cuboid."""
FIELDS = ("geom_friction", "dof_armature", "geom_size", "geom_rbound", "geom_aabb", "geom_rgba", "dof_M0")


def states(env: Any, seed: int) -> np.ndarray:
    env.reset(seed=seed)
    action = {"joints": np.full(7, 0.01), "gripper": np.zeros(1, np.float32)}
    return np.array([env.step(action) and env.simulation.world.states().copy() for _ in range(10)])


def test_a_named_field_varies_within_its_range_and_is_the_same_with_the_same_seed() -> None:
    env, again = (rcs.make("PickCuboid", randomisation=RANGES) for _ in range(2))
    model = env.simulation.world.model
    nominal = {field: getattr(model, field).copy() for field in FIELDS}
    cuboid = model.geom("cuboid").id
    frictions = []
    for seed in range(20):
        _, info = env.reset(seed=seed)
        drawn = info["randomisation"]
        assert list(drawn) == KEYS
        assert model.geom_friction[cuboid, 0] == drawn[KEYS[0]][0, 0]
        np.testing.assert_array_equal(model.geom_friction[cuboid, 1:], nominal["geom_friction"][cuboid, 1:])
        np.testing.assert_array_equal(model.dof_armature[ROBOT], nominal["dof_armature"][ROBOT] * drawn[KEYS[1]])
        np.testing.assert_array_equal(model.geom_size[cuboid], nominal["geom_size"][cuboid] * drawn[KEYS[2]])
        assert model.geom_rbound[cuboid] == pytest.approx(np.linalg.norm(model.geom_size[cuboid]))
        frictions.append(model.geom_friction[cuboid, 0])
    assert 0.3 <= min(frictions) < 0.45 < 1.05 < max(frictions) <= 1.2
    np.testing.assert_array_equal(states(again, 7), states(env, 7))
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(model, field), getattr(again.simulation.world.model, field))
    assert not np.array_equal(states(env, 7), states(env, 8))


def test_a_copy_is_bit_for_bit_the_single_environment_with_its_seed() -> None:
    envs = rcs.make_vec("PickCuboid", copies=3, threads=2, randomisation=RANGES, autoreset="Disabled")
    envs.reset(seed=20)
    batch = []
    for _ in range(10):
        envs.step({"joints": np.full((3, 7), 0.01), "gripper": np.zeros((3, 1), np.float32)})
        batch.append(envs.simulation.world.states().copy())
    for copy in range(3):
        single = rcs.make("PickCuboid", randomisation=RANGES)
        np.testing.assert_array_equal(states(single, 20 + copy), np.array(batch)[:, copy])
        for field in FIELDS:
            ours = envs.simulation.world.field(field)
            np.testing.assert_array_equal(ours[copy], getattr(single.simulation.world.model, field))


def test_a_recording_with_varied_fields_replays_bit_for_bit(tmp_path: Path) -> None:
    whole = rcs.make("PickCuboid", randomisation=RANGES, max_episode_steps=10)
    with whole as env, rcs.record_all(env, tmp_path / "data"):
        for seed in range(2):
            states(env, seed)
    results = list(replay(tmp_path / "data"))
    assert [result.is_equal for result in results] == [True, True]


def test_a_state_has_the_varied_fields() -> None:
    env, other = (rcs.make("PickCuboid", randomisation=RANGES) for _ in range(2))
    env.reset(seed=3)
    other.reset(seed=4)
    other.set_state(env.get_state())
    for field in FIELDS:
        np.testing.assert_array_equal(
            getattr(env.simulation.world.model, field), getattr(other.simulation.world.model, field)
        )


def test_a_field_range_acts_on_what_earlier_ranges_have_made_of_the_field() -> None:
    fields = (
        FieldRange("geom_friction", 2.0, 2.0, names="cuboid"),
        FieldRange("geom_friction", 0.5, 0.5, names="cuboid", operation="add", axes=(0,)),
    )
    env = rcs.make("PickCuboid", randomisation=Randomisation.off(friction=(0.5, 1.5), fields=fields))
    model = env.simulation.world.model
    cuboid = model.geom("cuboid").id
    nominal = model.geom_friction[cuboid].copy()
    for seed in range(3):
        _, info = env.reset(seed=seed)
        wanted = 2.0 * info["randomisation"]["friction"] * nominal + [0.5, 0.0, 0.0]
        np.testing.assert_allclose(model.geom_friction[cuboid], wanted, rtol=1e-12)


def test_a_geom_that_was_moved_or_enlarged_is_touched_where_its_surface_is() -> None:
    for fields, touches in (
        ((), False),
        ((FieldRange("geom_size", 1.5, 1.5, names="box"),), True),
        ((FieldRange("geom_pos", 0.1, 0.1, names="box", operation="add", axes=(0,)),), True),
    ):
        scene = Scene.empty()
        body = scene.spec.worldbody.add_body(name="box", pos=[0, 0, 1])
        for x in (-0.05, 0.05):  # two geoms: a body with one has no tree of bounding volumes to be wrong
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.05, 0.05, 0.05], pos=[x, 0, 0], mass=0.1)
        ball = scene.spec.worldbody.add_body(name="ball", pos=[0.145, 0, 1])
        ball.add_freejoint()
        for y in (0.0, 0.03):
            ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], pos=[0, y, 0], mass=0.1)
        scene.varied = fields
        world = World(scene.compile())
        Randomiser(world, Randomisation.off(fields=fields)).begin(EpisodeRandom(0, 0))
        mujoco.mj_forward(world.model, world.data)
        assert bool(world.data.ncon) == touches, fields


def test_quaternions_and_axes_stay_of_unit_length_and_colours_within_their_range() -> None:
    fields = (
        FieldRange("geom_quat", -0.3, 0.3, names="fr3/*", operation="add"),
        FieldRange("jnt_axis", -0.1, 0.1, names="fr3/*", operation="add"),
        FieldRange("geom_rgba", -2.0, 2.0, operation="add"),
    )
    env = rcs.make("PickCuboid", randomisation=Randomisation.off(fields=fields))
    env.reset(seed=0)
    model = env.simulation.world.model
    np.testing.assert_allclose(np.linalg.norm(model.geom_quat, axis=1), 1.0)
    np.testing.assert_allclose(np.linalg.norm(model.jnt_axis[:7], axis=1), 1.0)
    assert model.geom_rgba.min() == 0.0
    assert model.geom_rgba.max() == 1.0


def test_every_field_that_can_vary_does_so_in_a_batch() -> None:
    model = rcs.make("PickCuboid").simulation.world.model
    names = {"geom_size": "cuboid", "body_ipos": "fr3/*", "body_iquat": "fr3/*"}
    fields = tuple(
        FieldRange(field, 1e-3, 2e-3, names=names.get(field, "*"), operation="add")
        for field in variable_fields()
        if len(getattr(model, field))
    )
    envs = rcs.make_vec("PickCuboid", copies=2, randomisation=Randomisation.off(fields=fields))
    envs.reset(seed=0)
    for one in fields:
        own = envs.simulation.world.field(one.field)
        assert not np.array_equal(own[0], own[1]), one.field


def test_names_that_match_nothing_and_a_range_twice_are_refused() -> None:
    with pytest.raises(InvalidSetup, match="Did you mean 'cuboid'"):
        rcs.make(
            "PickCuboid", randomisation=Randomisation.off(fields=[FieldRange("geom_friction", 1, 2, names="cubiod")])
        )  # pyright: ignore[reportArgumentType]
    with pytest.raises(InvalidSetup, match="two ranges of"):
        Randomisation(fields=(FieldRange("dof_damping", 1, 2), FieldRange("dof_damping", 1, 3)))
