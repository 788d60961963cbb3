"""Variation of a task's objects: colour, size, mass and friction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs.variation.looks import add_colour
from rcs.sim.model_rows import ObjectParts, owners
from rcs.sim.world import Copies

if TYPE_CHECKING:  # the randomiser calls this module
    from rcs.envs.variation.randomiser import Randomiser, Values


def add_objects(vary: Randomiser, parts: Sequence[ObjectParts], names: Sequence[str]) -> None:
    """Vary colour, size and mass of objects."""
    coloured = [i for i, part in enumerate(parts) if len(part.geoms) or len(part.flexes)]
    if vary.enable("object_colour", [names[i] for i in coloured], each=(3,)):
        add_colour(vary, "object_colour", [parts[i].geoms for i in coloured])
        add_colour(vary, "object_colour", [parts[i].flexes for i in coloured], flexes=True)
    scalable = [i for i, part in enumerate(parts) if part.is_scalable]
    has_size = _add_sizes(vary, [parts[i] for i in scalable], [names[i] for i in scalable])
    has_mass = vary.enable("object_mass", names)
    if not (has_size or has_mass):
        return
    vary.changes_constants = True
    bodies = [part.bodies for part in parts]
    owner = owners(bodies)
    masses = vary.rows("body_mass", np.concatenate(bodies)) if has_mass else None
    inertias = vary.rows("body_inertia", np.concatenate(bodies))

    def write(drawn: dict[str, Values], copies: Copies) -> None:
        leading = drawn["object_mass" if has_mass else "object_size"].shape[:-1]
        factor = np.ones((*leading, len(parts)))
        if has_size:
            factor[..., scalable] *= drawn["object_size"] ** 2
        if masses is not None:
            factor *= drawn["object_mass"]
            masses.scale(drawn["object_mass"][..., owner], copies)
        inertias.scale(factor[..., owner], copies)

    vary.write_with(write)


def _add_sizes(vary: Randomiser, parts: Sequence[ObjectParts], names: Sequence[str]) -> bool:
    """Scale shapes about the root's frame, including their bounds; return whether sizes vary."""
    geoms = [part.geoms for part in parts]
    rows = {
        "geom_size": geoms,
        "geom_pos": geoms,
        "geom_rbound": geoms,
        "geom_aabb": geoms,
        "site_pos": [part.sites for part in parts],
        "body_ipos": [part.bodies for part in parts],
        "body_pos": [part.bodies[part.bodies != part.root] for part in parts],
        "bvh_aabb": [part.boxes for part in parts],
        "flex_radius": [part.flexes for part in parts],
        "flex_size": [part.flexes for part in parts],
        "flex_vert": [part.vertices for part in parts],
        "flex_node": [part.nodes for part in parts],
        # The material stays the same: forces grow with the area, strains fall with the length.
        "flex_stiffness": [part.stiffness for part in parts],
    }
    if not vary.scale("object_size", names, rows):
        return False
    nodes = [part.nodes for part in parts]
    if sum(map(len, nodes)):
        _add_nodes_at_rest(vary, parts, nodes)
    return True


def _add_nodes_at_rest(vary: Randomiser, parts: Sequence[ObjectParts], nodes: Sequence[NDArray[np.intp]]) -> None:
    """Scale where the nodes of soft bodies are when nothing pulls at them, which the model has in the scene."""
    at_rest = mujoco.MjData(vary.world.model)
    mujoco.mj_kinematics(vary.world.model, at_rest)
    owner = owners(nodes)
    center = at_rest.xpos[[part.root for part in parts]][owner]
    rows = vary.rows("flex_node0", np.concatenate(nodes))
    offset = rows.nominal - center

    def write(drawn: dict[str, Values], copies: Copies) -> None:
        rows.write(center + offset * drawn["object_size"][..., owner, None], copies)

    vary.write_with(write)


def add_friction(vary: Randomiser, parts: Sequence[ObjectParts], names: Sequence[str]) -> None:
    """Vary friction: all of it by one factor, and that of each object by another one on top."""
    model = vary.world.model
    has_all, has_own = vary.enable("friction", ["all"]), vary.enable("object_friction", names)
    if not (has_all or has_own):
        return
    # The number of the object that geoms, flexes and pairs of geoms belong to; -1 for none.
    of_geom, of_flex = np.full(model.ngeom, -1), np.full(model.nflex, -1)
    for i, part in enumerate(parts):
        of_geom[part.geoms] = of_flex[part.flexes] = i
    of_pair = np.maximum(of_geom[model.pair_geom1], of_geom[model.pair_geom2])
    objects = {"geom_friction": of_geom, "flex_friction": of_flex, "pair_friction": of_pair}
    rows = [(vary.rows(field, np.arange(len(own))), own) for field, own in objects.items() if len(own)]

    def write(drawn: dict[str, Values], copies: Copies) -> None:
        leading = drawn["friction" if has_all else "object_friction"].shape[:-1]
        common = drawn["friction"] if has_all else np.ones((*leading, 1))
        own = np.ones((*leading, len(parts) + 1))  # the last one, -1, is for what is no object's
        if has_own:
            own[..., :-1] = drawn["object_friction"]
        for frictions, owner in rows:
            frictions.scale(common * own[..., owner], copies)

    vary.write_with(write)
