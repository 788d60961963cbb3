"""A world's scene on a page in the browser: made once, then only bodies that have moved are sent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.sim.scene import OVERVIEW, RobotPlacement
from rcs.sim.shapes import Shape, body_name, contact_arrows, shapes_of, soft_vertices
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

NEWTON_LENGTH = 0.01
"""Length of an arrow per newton of contact force [m/N]."""

FIELD_OF_VIEW = 38.0
"""Vertical angle of view of a page at first [degrees]."""

TINTED = 0.6
"""Share of a tint in a colour."""

MOVED = 1e-6
"""Least change of a coordinate that is sent [m]."""


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
        self._arrows: Any = None
        self._root = f"/{name}"
        self._tint = None if tint is None else np.array(tint, np.float64)
        server.scene.add_frame(self._root, show_axes=False, position=np.array(place, np.float64))
        self.has_contacts = False
        """Show contact forces."""
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
        for name in [name for name, (shape, _) in self._shown.items() if not _looks_like(shape, shapes.get(name))]:
            self._shown.pop(name)[1].remove()
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
            self._show_contacts()
        self._poses[moved] = poses[moved]

    def remove(self) -> None:
        """Take everything off the page. Removing twice is harmless."""
        for handle in [*(handle for _, handle in self._shown.values()), *self._bodies.values()]:
            handle.remove()
        self._shown, self._bodies = {}, {}
        if self._arrows is not None:
            self._arrows.remove()
            self._arrows = None

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
        body = f"{self._root}/{_node(body_name(self._model, shape.body))}"
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

    def _show_contacts(self) -> None:
        """Show the forces of all contacts as arrows, or none."""
        arrows = contact_arrows(self._model, self._data, NEWTON_LENGTH) if self.has_contacts else np.zeros((0, 2, 3))
        if len(arrows) == 0:
            if self._arrows is not None:
                self._arrows.visible = False
            return
        if self._arrows is None:
            self._arrows = self._server.scene.add_arrows(
                f"{self._root}/contacts", arrows, (230, 60, 60), shaft_radius=0.002, head_radius=0.005, head_length=0.01
            )
        else:
            self._arrows.points, self._arrows.visible = arrows.astype(np.float32), True


def _looks_like(shape: Shape, other: Shape | None) -> bool:
    return other is not None and shape.look == other.look


def _node(name: str) -> str:
    """Return a name of MuJoCo's as one level of a path: its slashes would make another tree than the bodies'."""
    return name.replace("/", " \u00b7 ")
