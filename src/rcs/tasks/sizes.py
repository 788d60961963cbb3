"""Sizes of simple bodies that differ from copy to copy and from episode to episode."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs.layers import CopyIndex
from rcs.sim.model_rows import ModelRows
from rcs.sim.world import World

Extents = NDArray[np.float64]


class SizedBodies:
    """Bodies of one box or one upright cylinder each, whose sizes are written per copy.

    Writes everything that MuJoCo derives from a size: bounds of shape and body, and the inertia of a solid body. The
    size is then the task's alone: `object_size` of a `Randomisation` acts before it and is replaced.
    """

    def __init__(self, world: World, names: Sequence[str]) -> None:
        """Look the bodies up.

        Args:
            world: A world fresh from its model.
            names: Names of the bodies, which their geoms share.
        """
        model = world.model
        self._world = world
        geoms = np.array([model.geom(name).id for name in names], np.intp)
        bodies = np.array([model.body(name).id for name in names], np.intp)
        self._is_round = model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_CYLINDER
        boxes = model.body_bvhadr[bodies]  # of a body with one geom, its tree has one node
        self._size, self._radius, self._bounds = (
            ModelRows(world, field, geoms) for field in ("geom_size", "geom_rbound", "geom_aabb")
        )
        self._tree = ModelRows(world, "bvh_aabb", boxes)
        self._mass, self._inertia = (ModelRows(world, field, bodies) for field in ("body_mass", "body_inertia"))
        self._bodies = bodies

    def write(self, half: Extents, where: CopyIndex, density: float | None = None) -> None:
        """Write the sizes of some copies.

        Args:
            half: Half the extents of each body along its x, y, z [m], (*leading of these, bodies, 3). Of a cylinder, x
                and y are its radius.
            where: The copies; `...` for all, or for the only one.
            density: Density that gives the masses [kg/m³]; None to keep the present masses.
        """
        copies = None if where is ... else where
        x, y, z = half[..., 0], half[..., 1], half[..., 2]
        size = half.copy()
        size[..., 1] = np.where(self._is_round, z, y)
        size[..., 2] = np.where(self._is_round, 0.0, z)
        bounds = np.concatenate([np.zeros_like(half), half], axis=-1)
        self._size.write(size, copies)
        self._radius.write(np.sqrt(x * x + np.where(self._is_round, 0.0, y * y) + z * z), copies)
        self._bounds.write(bounds, copies)
        self._tree.write(bounds, copies)
        if density is None:
            mass: Extents = self._world.field("body_mass")[where][..., self._bodies]
        else:
            mass = density * np.where(self._is_round, 2.0 * np.pi, 8.0) * x * y * z
            self._mass.write(mass, copies)
        # Solid box: m (b² + c²) / 3 with half extents; solid cylinder: m (r² / 4 + h² / 3) across, m r² / 2 along.
        share = np.where(self._is_round, 0.25, 1.0 / 3.0)
        upright = share * y * y + z * z * (1.0 / 3.0), share * x * x + z * z * (1.0 / 3.0), share * (x * x + y * y)
        self._inertia.write(mass[..., None] * np.stack(upright, axis=-1), copies)
        self._world.update_constants(copies)
