"""A world's scene on a page in the browser: made once, then only bodies that have moved are sent."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.sim.scene import OVERVIEW, RobotPlacement
from rcs.sim.world import World
from rcs.spatial import Pose, wxyz_to_xyzw, xyzw_to_wxyz

if TYPE_CHECKING:
    import viser

WALLS = " wall"
"""End of the names of the room's walls, which would hide the room from outside."""

MIDDLE = (0.55, 0.15, 0.30)
"""Point in the middle of the page, from the base of a robot, in parts of its reach; the panel covers the right side."""

DISTANCE = 2.4
"""Distance of the page's camera from it, in parts of the reach."""

FIELD_OF_VIEW = 38.0
"""Vertical angle of view of a page at first [degrees]."""

TINTED = 0.6
"""Share of a tint in a colour."""

MOVED = 1e-6
"""Least change of a coordinate that is sent [m]."""

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
    flex: int | None = None
    """Id of the soft body; its vertices move with `soft_vertices`."""
    look: Hashable = None
    """Two shapes of one name with equal looks look the same."""


class BrowserScene:
    """Shapes of a world on a `viser` server, which the caller owns."""

    def __init__(
        self,
        server: viser.ViserServer,
        world: World,
        robots: Sequence[RobotPlacement],
        *,
        name: str = "scene",
        place: Sequence[float] = (0.0, 0.0, 0.0),
        tint: Sequence[float] | None = None,
    ) -> None:
        """Show a world.

        Args:
            server: The server of the page.
            world: A world of one copy.
            robots: Its robots, which pages look at first.
            name: Name of this scene on the page.
            place: Position of the world's origin on the page [m].
            tint: Colour of movable bodies, 0 … 1, mixed into their own; None for their own colours.

        Raises:
            InvalidSetup: The world has many copies.
        """
        if world.data is None:
            raise InvalidSetup("The browser shows a world of one copy.")
        self._server = server
        self._model, self._data = world.model, world.data
        # A copy, because the poses of a step are a moment behind its positions, and the state stays as it is.
        self._seen = mujoco.MjData(world.model)
        self._bodies: dict[int, Any] = {}
        self._shown: dict[str, tuple[Shape, Any]] = {}
        self._poses: NDArray[np.float64] = np.full((world.model.nbody, 7), np.inf)
        self._soft: dict[int, NDArray[np.float32]] = {}
        self._root = f"/{name}"
        self._tint = None if tint is None else np.array(tint, np.float64)
        server.scene.add_frame(self._root, show_axes=False, position=np.array(place, np.float64))
        self._look_at(robots)
        self.rebuild()

    def rebuild(self) -> None:
        """Update shapes and colours, such as after the start of an episode."""
        self._look()
        shapes = {
            shape.name: shape
            for shape in shapes_of(self._model, self._seen)
            if not (shape.body == 0 and shape.name.endswith(WALLS))
        }
        for name, (shape, handle) in list(self._shown.items()):
            if name not in shapes or shapes[name].look != shape.look:
                handle.remove()
                del self._shown[name]
        for name, shape in shapes.items():
            if name not in self._shown:
                self._shown[name] = shape, self._add(shape)
        self.show()

    def show(self) -> None:
        """Send the poses of the bodies that have moved since the last call."""
        self._look()
        data = self._seen
        poses = np.concatenate([data.xpos, data.xquat], axis=1)
        moved = np.abs(poses - self._poses).max(axis=1) > MOVED
        with self._server.atomic():
            for body in np.flatnonzero(moved):
                handle = self._bodies.get(int(body))
                if handle is not None:
                    handle.position, handle.wxyz = poses[body, :3], poses[body, 3:]
            for shape, handle in self._shown.values():
                if shape.flex is not None:
                    vertices = soft_vertices(self._model, data, shape.flex)
                    if shape.flex not in self._soft or np.abs(vertices - self._soft[shape.flex]).max() > MOVED:
                        handle.vertices = self._soft[shape.flex] = vertices
        self._poses[moved] = poses[moved]

    def _look(self) -> None:
        """Compute where everything is."""
        model, seen = self._model, self._seen
        seen.qpos[:], seen.mocap_pos[:], seen.mocap_quat[:] = (
            self._data.qpos, self._data.mocap_pos, self._data.mocap_quat,
        )  # fmt: skip
        mujoco.mj_kinematics(model, seen)
        mujoco.mj_flex(model, seen)

    def _look_at(self, robots: Sequence[RobotPlacement]) -> None:
        """Start every page with a view of the robots from the direction of the overview camera."""
        camera, start = self._model.camera(OVERVIEW), self._server.initial_camera
        # A camera of MuJoCo's looks along -z.
        forward = -Pose((0.0, 0.0, 0.0), tuple(wxyz_to_xyzw(camera.quat))).matrix[:3, 2]
        bases = np.array([robot.base_in_scene.translation for robot in robots])
        reach = max(robot.arm.workspace_reach for robot in robots)
        middle = bases.mean(axis=0) + np.array(MIDDLE) * reach
        distance = DISTANCE * (reach + np.ptp(bases, axis=0).max() / 2)
        start.position, start.look_at = tuple(middle - distance * forward), tuple(middle)
        start.up = (0.0, 0.0, 1.0)
        start.fov = np.deg2rad(FIELD_OF_VIEW)

    def _add(self, shape: Shape) -> Any:
        vertices, faces = shape.mesh
        scene = self._server.scene
        name = self._model.body(shape.body).name or f"body {shape.body}"
        body = f"{self._root}/{_node(name)}"
        if shape.body and shape.body not in self._bodies:
            self._bodies[shape.body] = scene.add_frame(body, show_axes=False)
        return scene.add_mesh_simple(
            f"{body}/{_node(shape.name)}",
            vertices,
            faces,
            color=self._colour(shape),
            opacity=None if shape.rgba[3] == 1.0 else shape.rgba[3],
            side="front" if shape.flex is None else "double",
            position=shape.in_body[:3],
            wxyz=xyzw_to_wxyz(shape.in_body[3:]),
        )

    def _colour(self, shape: Shape) -> NDArray[np.float64]:
        colour = np.array(shape.rgba[:3])
        if self._tint is None or shape.body == 0:
            return colour
        return (1 - TINTED) * colour + TINTED * self._tint


def _node(name: str) -> str:
    """Return a name of MuJoCo's as one level of a path: its slashes would make another tree than the bodies'."""
    return name.replace("/", " \u00b7 ")


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
    first, count = int(model.flex_vertadr[flex]), int(model.flex_vertnum[flex])
    return data.flexvert_xpos[first : first + count].astype(np.float32)


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


def _triangles_of(model: mujoco.MjModel, flex: int) -> NDArray[np.uint32]:
    """Return the surface of a soft body: its elements are triangles, or tetrahedra with a shell around them."""
    if model.flex_dim[flex] == 2:
        first, count, every = model.flex_elemdataadr[flex], model.flex_elemnum[flex], model.flex_elem
    else:
        first, count, every = model.flex_shelldataadr[flex], model.flex_shellnum[flex], model.flex_shell
    return every[first : first + 3 * count].reshape(-1, 3).astype(np.uint32)


def _mesh_of(model: mujoco.MjModel, geom: int) -> Mesh | None:
    """Return the triangles of a geom in its own frame; None for a kind that is not shown."""
    from trimesh.creation import box, revolve  # comes with viser

    kinds = mujoco.mjtGeom
    kind, size = kinds(int(model.geom_type[geom])), np.array(model.geom_size[geom], np.float64)
    if kind in (kinds.mjGEOM_MESH, kinds.mjGEOM_SDF):
        return _mesh(model, int(model.geom_dataid[geom]))
    quarter = np.linspace(0.0, np.pi / 2, AROUND // 4 + 1)
    lower = np.column_stack([np.sin(quarter), -np.cos(quarter)])
    upper = lower[::-1] * (1.0, -1.0)
    radius, half = size[:2]
    stretch: Any = 1.0
    if kind == kinds.mjGEOM_BOX:
        made = box(2 * size)
        made.unmerge_vertices()
        return made.vertices.astype(np.float32), made.faces.astype(np.uint32)
    if kind == kinds.mjGEOM_PLANE:
        half_x, half_y = (extent or HALF_PLANE for extent in size[:2])
        corners = [[-half_x, -half_y, 0], [half_x, -half_y, 0], [half_x, half_y, 0], [-half_x, half_y, 0]]
        return np.array(corners, np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    if kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
        profile, stretch = np.concatenate([lower, upper[1:]]), radius if kind == kinds.mjGEOM_SPHERE else size
    elif kind == kinds.mjGEOM_CAPSULE:
        profile = np.concatenate([radius * lower - (0.0, half), radius * upper + (0.0, half)])
    elif kind == kinds.mjGEOM_CYLINDER:
        rims = [(0.0, -half), (radius, -half), (radius, -half), (radius, half), (radius, half), (0.0, half)]
        profile = np.array(rims)
    else:
        return None
    made = revolve(profile, sections=AROUND, process=False)
    return (made.vertices * stretch).astype(np.float32), made.faces.astype(np.uint32)


def _mesh(model: mujoco.MjModel, mesh: int) -> Mesh:
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    corners = np.stack([model.mesh_face, model.mesh_facenormal], axis=-1)[first : first + count].reshape(-1, 2)
    # A vertex with two normals is at a crease.
    pairs, index = np.unique(corners, axis=0, return_inverse=True)
    vertices = model.mesh_vert[int(model.mesh_vertadr[mesh]) + pairs[:, 0]]
    return vertices.astype(np.float32), index.reshape(-1, 3).astype(np.uint32)
