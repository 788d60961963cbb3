"""Coloured triangles of a model in the frames of its bodies, for viewers other than MuJoCo's."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.spatial import wxyz_to_xyzw

Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]
"""Vertices (n, 3) [m] and triangles (m, 3). Vertices at a crease are there once per side, for smooth shading."""

HIDDEN_FROM_GROUP = 3
"""Geoms of this group and above are not shown, as in MuJoCo's own viewer; collision shapes are in group 3."""

AROUND = 32
"""Edges of round shapes."""

HALF_PLANE = 5.0
"""Half of an edge of a plane without end [m]."""

_DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo takes the colour of the material for geoms of this colour (its `setMaterial`)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Shape:
    """One geom, or the surface of one soft body."""

    name: str
    """Different for every shape of a model."""
    body: int
    """Id of the body that carries it; 0, the world, for a soft body."""
    in_body: NDArray[np.float64]
    """Pose in the frame of the body, (7,): [m], xyzw."""
    mesh: Mesh
    """Triangles; of a soft body where they are now."""
    rgba: tuple[float, float, float, float]
    """Colour, 0 … 1."""
    geom: int | None = None
    """Id of the geom."""
    flex: int | None = None
    """Id of the soft body; its vertices move with `soft_vertices`."""
    look: Hashable = None
    """Two shapes of one name with equal looks look the same."""


def body_name(model: mujoco.MjModel, body: int) -> str:
    """Return the name of a body, or one made of its id."""
    return model.body(body).name or f"body {body}"


def shapes_of(model: mujoco.MjModel, data: mujoco.MjData) -> list[Shape]:
    """Return every visible geom and soft body of a model, each once.

    Height fields and cables (flexes of one dimension) are left out. A texture comes to its mean colour.

    Args:
        model: The model; what varies between episodes is taken as it is now.
        data: Its state, which soft bodies are shown in.
    """
    shapes: list[Shape] = []
    for geom in range(model.ngeom):
        rgba = colour_of(model, model.geom_rgba[geom], model.geom_matid[geom])
        if model.geom_group[geom] >= HIDDEN_FROM_GROUP or rgba[3] == 0.0:
            continue
        mesh = _mesh_of(model, geom)
        if mesh is None:
            continue
        place = np.concatenate([model.geom_pos[geom], wxyz_to_xyzw(model.geom_quat[geom])])
        body, kind, asset = (int(a[geom]) for a in (model.geom_bodyid, model.geom_type, model.geom_dataid))
        shapes.append(
            Shape(
                name=model.geom(geom).name or f"geom {geom}",
                body=body,
                in_body=place,
                mesh=mesh,
                rgba=rgba,
                geom=geom,
                look=(kind, asset, rgba, tuple(model.geom_size[geom]), tuple(place)),
            )
        )
    for flex in range(model.nflex):
        if model.flex_dim[flex] > 1 and model.flex_group[flex] < HIDDEN_FROM_GROUP:
            rgba = colour_of(model, model.flex_rgba[flex], model.flex_matid[flex])
            shapes.append(
                Shape(
                    name=f"soft {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, flex) or flex}",
                    body=0,
                    in_body=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
                    mesh=(soft_vertices(model, data, flex), _triangles_of(model, flex)),
                    rgba=rgba,
                    flex=flex,
                    look=rgba,
                )
            )
    return shapes


def soft_vertices(model: mujoco.MjModel, data: mujoco.MjData, flex: int) -> NDArray[np.float32]:
    """Return where the vertices of a soft body are in the world now, (n, 3) [m]."""
    return data.flexvert_xpos[_vertices_of(model, flex)].astype(np.float32)


def contact_arrows(model: mujoco.MjModel, data: mujoco.MjData, metres_per_newton: float) -> NDArray[np.float32]:
    """Return the force of every contact as an arrow from its point, (contacts, 2, 3) [m] in the world.

    Args:
        model: The model.
        data: Its state, after a step.
        metres_per_newton: Length of an arrow per force [m/N].
    """
    arrows = np.zeros((data.ncon, 2, 3), np.float32)
    wrench = np.zeros(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        mujoco.mj_contactForce(model, data, i, wrench)
        # Rows of a contact's frame are its axes, the first is the normal (MuJoCo documentation, mjContact).
        force = contact.frame.reshape(3, 3).T @ wrench[:3]
        arrows[i] = contact.pos, contact.pos + metres_per_newton * force
    return arrows


def colour_of(model: mujoco.MjModel, own: NDArray[np.float32], material: int) -> tuple[float, float, float, float]:
    """Return the colour of a geom or flex, 0 … 1: its own, or that of its material with the mean of the texture.

    Args:
        model: The model.
        own: Its `rgba`.
        material: Id of its material; -1 for none.
    """
    rgba = np.array(own, np.float64)
    if material >= 0:
        if tuple(np.round(rgba, 6)) == _DEFAULT_RGBA:
            rgba = np.array(model.mat_rgba[material], np.float64)
        texture = int(model.mat_texid[material][mujoco.mjtTextureRole.mjTEXROLE_RGB])
        if texture >= 0:
            channels = int(model.tex_nchannel[texture])
            first, count = int(model.tex_adr[texture]), int(model.tex_width[texture] * model.tex_height[texture])
            pixels = model.tex_data[first : first + count * channels].reshape(count, channels)
            rgba[:3] *= pixels[:, :3].mean(axis=0) / 255.0
    red, green, blue, alpha = np.round(np.clip(rgba, 0.0, 1.0), 6)
    return float(red), float(green), float(blue), float(alpha)


def _vertices_of(model: mujoco.MjModel, flex: int) -> slice:
    first = int(model.flex_vertadr[flex])
    return slice(first, first + int(model.flex_vertnum[flex]))


def _triangles_of(model: mujoco.MjModel, flex: int) -> NDArray[np.uint32]:
    """Return the surface of a soft body: its elements are triangles, or tetrahedra with a shell around them."""
    if model.flex_dim[flex] == 2:
        first, count, every = model.flex_elemdataadr[flex], model.flex_elemnum[flex], model.flex_elem
    else:
        first, count, every = model.flex_shelldataadr[flex], model.flex_shellnum[flex], model.flex_shell
    return every[first : first + 3 * count].reshape(-1, 3).astype(np.uint32)


def _mesh_of(model: mujoco.MjModel, geom: int) -> Mesh | None:
    """Return the triangles of a geom in its own frame; None for a kind that is not shown."""
    kinds = mujoco.mjtGeom
    kind, size = kinds(int(model.geom_type[geom])), np.array(model.geom_size[geom], np.float64)
    if kind in (kinds.mjGEOM_MESH, kinds.mjGEOM_SDF):
        return _mesh(model, int(model.geom_dataid[geom]))
    if kind == kinds.mjGEOM_BOX:
        return _box(size)
    if kind == kinds.mjGEOM_PLANE:
        half_x, half_y = (extent or HALF_PLANE for extent in size[:2])
        corners = [[-half_x, -half_y, 0], [half_x, -half_y, 0], [half_x, half_y, 0], [-half_x, half_y, 0]]
        return np.array(corners, np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    quarter = np.linspace(0.0, np.pi / 2, AROUND // 4 + 1)
    lower = np.column_stack([np.sin(quarter), -np.cos(quarter)])
    upper = lower[::-1] * (1.0, -1.0)
    if kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
        vertices, faces = _revolved(np.concatenate([lower, upper[1:]]))
        return (vertices * (size[:1] if kind == kinds.mjGEOM_SPHERE else size)).astype(np.float32), faces
    radius, half = size[:2]
    if kind == kinds.mjGEOM_CAPSULE:
        return _revolved(np.concatenate([radius * lower - (0.0, half), radius * upper + (0.0, half)]))
    if kind == kinds.mjGEOM_CYLINDER:
        rims = [(0.0, -half), (radius, -half), (radius, -half), (radius, half), (radius, half), (0.0, half)]
        return _revolved(np.array(rims))
    return None


def _mesh(model: mujoco.MjModel, mesh: int) -> Mesh:
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    corners = np.stack([model.mesh_face, model.mesh_facenormal], axis=-1)[first : first + count].reshape(-1, 2)
    # A vertex with two normals is at a crease.
    pairs, index = np.unique(corners, axis=0, return_inverse=True)
    vertices = model.mesh_vert[int(model.mesh_vertadr[mesh]) + pairs[:, 0]]
    return vertices.astype(np.float32), index.reshape(-1, 3).astype(np.uint32)


def _box(half: NDArray[np.float64]) -> Mesh:
    vertices: list[NDArray[np.float64]] = []
    for axis in range(3):
        first, second = np.roll(np.eye(3), -axis, axis=1)[1:]  # with the axis they are right-handed
        normal = np.cross(first, second)
        for sign in (1.0, -1.0):
            corners = ((-1, -1), (1, -1), (1, 1), (-1, 1))[:: int(sign)]
            vertices += [half * (sign * normal + a * first + b * second) for a, b in corners]
    faces = [[4 * side + i for i in triangle] for side in range(6) for triangle in ((0, 1, 2), (0, 2, 3))]
    return np.array(vertices, np.float32), np.array(faces, np.uint32)


def _revolved(profile: NDArray[np.float64]) -> Mesh:
    """Return the surface that a line makes around the z axis.

    Args:
        profile: Points of the line from bottom to top: distance from the axis and height [m], (n, 2). Two equal ones
            are a crease.
    """
    angles = np.linspace(0.0, 2 * np.pi, AROUND, endpoint=False)
    radius, height = profile[:, :1], np.broadcast_to(profile[:, 1:], (len(profile), AROUND))
    vertices = np.stack([radius * np.cos(angles), radius * np.sin(angles), height], axis=-1)
    here = np.arange(AROUND)
    after = np.roll(here, -1)
    rings = np.arange(len(profile) - 1)[:, None] * AROUND
    lower, upper = rings + here, rings + here + AROUND
    lower_after, upper_after = rings + after, rings + after + AROUND
    faces = np.concatenate(
        [np.stack([lower, lower_after, upper_after], axis=-1), np.stack([lower, upper_after, upper], axis=-1)]
    ).reshape(-1, 3)
    points = vertices.reshape(-1, 3).astype(np.float32)
    # At the poles and in creases, triangles have no area.
    a, b, c = (points[faces[:, i]] for i in range(3))
    has_area = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0.0
    return points, faces[has_area].astype(np.uint32)
