"""Rows of a model's field with individual values per copy, such as masses of bodies or colours of geoms."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.sim.model_fields import SIMPLE_SHAPES
from rcs.sim.world import Copies, World


class ModelRows:
    """Some rows of one field, with their nominal values."""

    def __init__(self, world: World, field: str, rows: ArrayLike) -> None:
        """Give the field values per copy.

        Args:
            world: The world, whose model still has the nominal values.
            field: Name in MuJoCo, such as `body_mass`.
            rows: The rows: ids of bodies, geoms, …
        """
        self.rows = np.asarray(rows, np.intp)
        self._has_copies = bool(world.leading)
        self._live = world.vary(field)
        self.nominal: NDArray[Any] = np.array((self._live[0] if self._has_copies else self._live)[self.rows])
        """Values before the first episode, (rows, ...)."""

    def read(self, copies: Copies = None) -> NDArray[Any]:
        """Return the present values of some copies, (*leading of the copies, rows, ...)."""
        if not self._has_copies:
            return self._live[self.rows]
        return self._live[slice(None) if copies is None else copies][:, self.rows]

    def write(self, values: NDArray[Any], copies: Copies = None) -> None:
        """Write the values of some copies.

        Args:
            values: Shape (*leading of the copies, rows, ...).
            copies: The copies; None for all, or for the only one.
        """
        if not self._has_copies:
            self._live[self.rows] = values
        elif copies is None:
            self._live[:, self.rows] = values
        else:
            self._live[np.ix_(copies, self.rows)] = values

    def scale(self, factors: NDArray[np.float64], copies: Copies = None) -> None:
        """Write the nominal values times a factor for each row, (*leading, rows)."""
        self.write(self.nominal * factors.reshape(factors.shape + (1,) * (self.nominal.ndim - 1)), copies)


class ObjectParts:
    """The parts of one object in a model: its body, everything attached to it, and their shapes, rigid and soft."""

    def __init__(self, world: World, body: str) -> None:
        """Look an object up.

        Raises:
            KeyError: The body is not in the model.
        """
        model = world.model
        self.root = int(model.body(body).id)
        inside = world.subtree(body)
        self.bodies = np.flatnonzero(inside)
        self.geoms = np.flatnonzero(inside[model.geom_bodyid])
        self.sites = np.flatnonzero(inside[model.site_bodyid])
        self.flexes = np.flatnonzero(world.subtree_flexes(body))
        self.vertices = _rows_of(self.flexes, model.flex_vertadr, model.flex_vertnum)
        self.nodes = _rows_of(self.flexes, model.flex_nodeadr, model.flex_nodenum)
        self.stiffness = _rows_of(self.flexes, model.flex_stiffnessadr, _stiffness_count(model))
        """Rows of the flexes' vertices, nodes and stiffness."""
        self.boxes = _rows_of(self.bodies, model.body_bvhadr, model.body_bvhnum)
        """Nodes of the bodies' bounding volume trees."""
        joints = np.flatnonzero(inside[model.jnt_bodyid])
        moving = np.append(model.flex_nodebodyid[self.nodes], self.root)
        self.is_scalable = bool(
            (len(self.geoms) or len(self.flexes))
            and np.isin(model.geom_type[self.geoms], SIMPLE_SHAPES).all()
            and _have_nodes_alone(model, self.flexes)
            and np.isin(model.jnt_bodyid[joints], moving).all()
        )
        """True for simple rigid shapes, and for soft solids that follow nodes. Meshes are shared by all
        copies and keep their size, as do soft bodies with springs along their edges."""


def _rows_of(elements: NDArray[np.intp], first: NDArray[np.int32], count: NDArray[np.int32]) -> NDArray[np.intp]:
    return np.concatenate([np.arange(0), *(np.arange(int(count[i])) + int(first[i]) for i in elements)])


def _stiffness_count(model: Any) -> NDArray[np.int32]:
    """Return the number of stiffness values of each flex that is elastic between nodes; 0 for others."""
    nodes_per_cell = (model.flex_interp + 1) ** 3
    count = model.flex_cellnum.prod(axis=1, dtype=np.int32) * (3 * nodes_per_cell) ** 2
    return np.where((model.flex_interp > 0) & (model.flex_stiffnessadr >= 0), count, 0)


def _have_nodes_alone(model: Any, flexes: NDArray[np.intp]) -> bool:
    """Return whether flexes are solids that are elastic only between nodes, the only elasticity that can be scaled."""
    has_edges = (model.flex_edgestiffness[flexes] != 0) | (model.flex_edgeequality[flexes] != 0)
    is_plastic = model.flex_plasticadr[flexes] >= 0
    is_of_nodes = (model.flex_dim[flexes] == 3) & (model.flex_interp[flexes] > 0)
    return bool((is_of_nodes & ~has_edges & ~is_plastic).all())


def owners(parts: Iterable[NDArray[np.intp]]) -> NDArray[np.intp]:
    """Return the part of each row, for parts one after the other."""
    lengths = [len(part) for part in parts]
    return np.repeat(np.arange(len(lengths)), lengths)


def colours(world: World, geoms: NDArray[np.intp]) -> NDArray[np.float32]:
    """Return the visible colours of geoms, (geoms, 4): their own, or else their material's."""
    model = world.model
    rgba: NDArray[np.float32] = np.array(model.geom_rgba[geoms])
    materials = model.geom_matid[geoms]
    # MuJoCo's renderer treats this grey, a geom's default, as "no colour".
    has_none = (rgba == np.array([0.5, 0.5, 0.5, 1.0], np.float32)).all(axis=-1) & (materials >= 0)
    rgba[has_none] = model.mat_rgba[materials[has_none]]
    return rgba
