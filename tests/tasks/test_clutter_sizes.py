"""Sizes that are written give the model that MuJoCo would compile, for one copy and for many."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from rcs.sim import Scene, World
from rcs.tasks.clutter import SizedBodies

SHAPES = {"brick": mujoco.mjtGeom.mjGEOM_BOX, "can": mujoco.mjtGeom.mjGEOM_CYLINDER}
HALF = np.array([[0.03, 0.02, 0.01], [0.025, 0.025, 0.04]])
DENSITY = 450.0


def compiled(half: Any, mass: float | None = None) -> mujoco.MjModel:
    scene = Scene.empty()
    for (name, kind), (x, y, z) in zip(SHAPES.items(), half, strict=True):
        body = scene.spec.worldbody.add_body(name=name, pos=[0, 0, 1])
        body.add_freejoint()
        size = [x, y, z] if kind == mujoco.mjtGeom.mjGEOM_BOX else [x, z, 0]
        body.add_geom(name=name, type=kind, size=size, density=DENSITY)
        if mass is not None:
            scene.spec.geom(name).mass = mass
    return scene.compile()


@pytest.mark.parametrize("mass", [None, 0.05])
@pytest.mark.parametrize("copies", [None, 2])
def test_written_sizes_are_those_that_mujoco_would_compile(copies: int | None, mass: float | None) -> None:
    expected, world = compiled(HALF, mass), World(compiled(1.5 * HALF[:, ::-1][:, [0, 0, 2]], mass), copies=copies)
    sizes = SizedBodies(world, list(SHAPES))
    where = ... if copies is None else np.array([1])
    sizes.write(HALF if copies is None else HALF[None], where, DENSITY if mass is None else None)
    for name in dir(expected):
        value = getattr(expected, name)
        if isinstance(value, np.ndarray) and not name.startswith("_") and name != "qpos0" and name in CONCERNED:
            own = world.field(name) if copies is None else world.field(name)[1]
            np.testing.assert_allclose(own, value, rtol=1e-9, atol=1e-12, err_msg=name)


def test_other_copies_keep_their_sizes() -> None:
    world = World(compiled(HALF), copies=3)
    sizes = SizedBodies(world, list(SHAPES))
    before = {name: world.field(name).copy() for name in CONCERNED}
    sizes.write(2 * HALF[None], np.array([1]), DENSITY)
    for name, values in before.items():
        np.testing.assert_array_equal(world.field(name)[[0, 2]], values[[0, 2]], err_msg=name)
    assert (world.field("body_mass")[1, 1:] > 7.9 * before["body_mass"][1, 1:]).all()


CONCERNED = (
    "geom_size",
    "geom_rbound",
    "geom_aabb",
    "bvh_aabb",
    "body_mass",
    "body_inertia",
    "body_invweight0",
    "body_subtreemass",
    "dof_invweight0",
    "dof_M0",
)
"""Fields that MuJoCo derives from sizes."""
