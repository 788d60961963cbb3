"""Variation of what is in a scene: lights, surfaces, cameras, and the task's objects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.sim.model_rows import ObjectParts, colours, owners
from rcs.sim.scene import TABLE, CameraPlacement
from rcs.sim.textures import texture_name
from rcs.sim.world import Copies
from rcs.spatial import compose, normalize, wxyz_to_xyzw, xyzw_to_wxyz

if TYPE_CHECKING:  # the randomiser calls this module
    from rcs.envs.variation.randomiser import Randomiser, Values


def add_lights(vary: Randomiser) -> None:
    """Vary brightness, directions and positions of all lights."""
    model = vary.world.model
    names = [model.light(i).name for i in range(model.nlight)]
    lights = np.arange(model.nlight)
    parts = ("light_ambient", "light_diffuse", "light_specular")
    vary.scale("light_intensity", names, dict.fromkeys(parts, lights[:, None]))
    if vary.enable("light_direction", names, each=(3,)):
        directions = vary.rows("light_dir", lights)
        vary.write_with(
            lambda drawn, copies: directions.write(_turned(directions.nominal, drawn["light_direction"]), copies)
        )
    if vary.enable("light_position", names, each=(3,)):
        positions = vary.rows("light_pos", lights)
        vary.write_with(lambda drawn, copies: positions.write(positions.nominal + drawn["light_position"], copies))


def add_surfaces(vary: Randomiser) -> None:
    """Vary the colours of room and table, and the texture of its top."""
    world, model = vary.world, vary.world.model
    room = [i for i in np.flatnonzero(model.geom_bodyid == 0) if model.geom(i).name]
    if vary.enable("room_colour", [model.geom(i).name for i in room], each=(3,)):
        add_colour(vary, "room_colour", [np.array([i]) for i in room])
    try:
        table = np.flatnonzero(world.subtree(TABLE)[model.geom_bodyid])
    except KeyError:
        return
    top = np.array([i for i in table if model.geom(i).name], np.intp)
    if vary.enable("textures", [TABLE] if len(top) else [], finish=np.floor):
        looks = [int(model.material(texture_name(i)).id) for i in range(vary.ranges.textures)]
        materials, own_colour = vary.rows("geom_matid", top), vary.rows("geom_rgba", top)
        own_colour.write(colours(world, top))
        choices = np.column_stack([materials.nominal, *(np.full(len(top), look) for look in looks)])
        vary.write_with(
            lambda drawn, copies: materials.write(
                choices[np.arange(len(top)), drawn["textures"].astype(np.intp)], copies
            )
        )
    if vary.enable("table_colour", [TABLE], each=(3,)):
        add_colour(vary, "table_colour", [table])


def add_colour(vary: Randomiser, field: str, groups: Sequence[NDArray[np.intp]], *, flexes: bool = False) -> None:
    """Shift the colours of groups of geoms or flexes, each group by the same amount."""
    members, group = np.concatenate(groups), owners(groups)
    if not len(members):
        return
    rows = vary.rows("flex_rgba" if flexes else "geom_rgba", members)
    nominal = (rows.nominal if flexes else colours(vary.world, members)).astype(np.float64)

    def write(drawn: dict[str, Values], copies: Copies) -> None:
        shift = drawn[field][..., group, :]
        rgba = np.empty((*shift.shape[:-1], 4))
        rgba[..., :3] = np.clip(nominal[:, :3] + shift, 0.0, 1.0)
        rgba[..., 3] = nominal[:, 3]
        rows.write(rgba, copies)

    vary.write_with(write)


def add_cameras(vary: Randomiser, cameras: Sequence[CameraPlacement]) -> None:
    """Vary poses and fields of view of cameras."""
    model = vary.world.model
    names = [camera.name for camera in cameras]
    moves = [vary.enable(field, names, each=(3,)) for field in ("camera_translation", "camera_rotation")]
    if any(moves):
        vary.changes_constants = True
        # Moves the camera's body, whose frame is the optical one, so that the housing never gets into the view.
        bodies = [model.body(f"{camera.name}/{camera.camera.base_body}").id for camera in cameras]
        positions, quaternions = vary.rows("body_pos", bodies), vary.rows("body_quat", bodies)
        nominal = np.concatenate([positions.nominal, wxyz_to_xyzw(quaternions.nominal)], axis=-1)

        def write_poses(drawn: dict[str, Values], copies: Copies) -> None:
            jitter = _small_pose(drawn.get("camera_translation"), drawn.get("camera_rotation"))
            poses = compose(np.broadcast_to(nominal, jitter.shape), jitter)
            positions.write(poses[..., :3], copies)
            quaternions.write(xyzw_to_wxyz(poses[..., 3:]), copies)

        vary.write_with(write_poses)
    if vary.enable("field_of_view", names):
        ids = [model.camera(camera.camera_name).id for camera in cameras]
        angles, intrinsics = vary.rows("cam_fovy", ids), vary.rows("cam_intrinsic", ids)

        def write_views(drawn: dict[str, Values], copies: Copies) -> None:
            factor = drawn["field_of_view"]
            angles.scale(factor, copies)
            # Cameras with a sensor size use a focal length, which falls as the angle grows.
            focal = np.ones((*factor.shape, 4))
            focal[..., :2] = 1.0 / factor[..., None]
            intrinsics.write(intrinsics.nominal * focal, copies)

        vary.write_with(write_views)


def _turned(directions: NDArray[np.float64], turns: Values) -> Values:
    """Return directions turned by small rotation vectors [rad], to first order and at their old length of 1."""
    x, y, z = (directions[..., i] + np.cross(turns, directions)[..., i] for i in range(3))
    length = np.sqrt(x * x + y * y + z * z)
    return np.stack([x / length, y / length, z / length], axis=-1)


def _small_pose(translation: Values | None, rotation: Values | None) -> Values:
    """Return small motions as tquat, from translations [m] and rotation vectors [rad], to second order of the angle."""
    given = rotation if translation is None else translation
    assert given is not None
    pose = np.zeros((*given.shape[:-1], 7))
    pose[..., 6] = 1.0
    if translation is not None:
        pose[..., :3] = translation
    if rotation is not None:
        pose[..., 3:6] = rotation / 2
    return normalize(pose)


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
