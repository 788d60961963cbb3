"""A tactile sensor with a camera behind its gel, such as the DIGIT, in a world of one copy or of many.

Rays from the sensor's camera find objects in the gel, with the precision of the geometry and without OpenGL. The gel's
surface follows, and its lights make the frame (`gel`). Contacts in MuJoCo are much stiffer than a gel, so
by default the measured contact force determines the indentation. Soft bodies (flexes) are not felt.
"""

from __future__ import annotations

import copy as copying
from typing import Any, Literal, get_args

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.errors import InvalidSetup
from rcs.sim.gel import Gel, GelLight
from rcs.sim.tactile_mounts import UNFELT_GROUP, TactilePlacement
from rcs.sim.world import World

Indentation = Literal["force", "geometry"]
"""Source of the indentation. `force`: the normal force on the gel, in proportion up to the sensor's largest.
`geometry`: how far objects are inside the gel, for poses that are set, not simulated."""

TactileLook = Literal["rcs", "tacto"]
"""The renderer of frames: RCS, or Tacto (extra `tacto`)."""

FELT_GROUPS = (0, 3)
"""Groups of geoms that are felt: 0 collides and is visible, 3 only collides."""
FELT_FIELDS = ("body_pos", "body_quat", "geom_pos", "geom_quat", "geom_size", "geom_rbound", "geom_aabb", "bvh_aabb")
"""Fields of the model with places and sizes of geoms, which may vary between copies."""
COARSER = 2
"""Every second ray finds the deepest point; all rays are cast only near a contact."""


class SimTactile:
    """One tactile sensor of a world. Frames are (*world.leading, height, width, 3)."""

    def __init__(
        self,
        world: World,
        placement: TactilePlacement,
        *,
        indentation: Indentation = "force",
        look: TactileLook = "rcs",
    ) -> None:
        """Look the sensor up in a world, and register the force on its gel for readout.

        Args:
            world: The world.
            placement: A sensor of its scene.
            indentation: Source of the indentation.
            look: The renderer of frames.

        Raises:
            InvalidSetup: The sensor is not in the world, or an option is not valid.
            MissingDependency: Tacto is chosen but not installed.
        """
        if indentation not in get_args(Indentation) or look not in get_args(TactileLook):
            raise InvalidSetup(
                f"indentation={indentation!r}, look={look!r}; valid: {get_args(Indentation)} and "
                f"{get_args(TactileLook)}."
            )
        self.placement = placement
        self.gel = Gel(placement.sensor)
        self._world = world
        self._by_force = indentation == "force"
        if look == "tacto":
            from rcs.sim.tacto import Tacto  # needs packages that most users do not have

            self._renderer = Tacto(placement.sensor, self.gel)
        else:
            self._renderer = GelLight(placement.sensor, self.gel)
        model = world.model
        try:
            self._body: int = model.body(placement.body_name).id
            self._force = read_force(world, placement)
        except KeyError as err:
            raise InvalidSetup(f"Tactile sensor {placement.name!r} is not in this model: {err}") from err
        # The body that carries the sensor is not felt; for the world, this includes all fixed bodies.
        fixed_to = model.body_weldid[self._body]
        bodies = model.geom_bodyid
        self._is_own = bodies == self._body if fixed_to == 0 else model.body_weldid[bodies] == fixed_to
        groups = np.zeros(mujoco.mjNGROUP, np.uint8)
        groups[list(FELT_GROUPS)] = 1
        self._groups = groups
        self._felt = np.flatnonzero((groups[model.geom_group] == 1) & ~self._is_own)
        self._rays = np.stack(self.gel.ray_slopes, axis=-1)
        self._shapes: mujoco.MjModel | None = None
        self._poses: mujoco.MjData | None = None

    @property
    def force(self) -> NDArray[np.float64]:
        """Normal force on the gel in the last physics step [N], (*leading,), a fresh array."""
        return self._world.forces[..., self._force].copy()

    def read(self, forces: ArrayLike | None = None) -> dict[str, NDArray[Any]]:
        """Return the present frame.

        Args:
            forces: Normal forces on the gel [N], (*leading,), for a state that this world has not stepped to; None for
                those of its last physics step.

        Returns:
            `rgb` (*leading, H, W, 3) uint8, and `indentation` (*leading, H, W) float32: displacement of the gel's
            surface towards the camera [m], 0 without contact.
        """
        width, height = self.gel.size
        leading = self._world.leading
        rgb = np.empty((*leading, height, width, 3), np.uint8)
        indentation = np.empty((*leading, height, width), np.float32)
        normal = self.force if forces is None else np.broadcast_to(np.asarray(forces, np.float64), leading)
        for copy in np.ndindex(leading):
            indentation[copy] = self._feel(copy, float(normal[copy]))
            rgb[copy] = self._renderer.draw(indentation[copy])
        return {"rgb": rgb, "indentation": indentation}

    def _present(self, copy: tuple[int, ...]) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Return the model (without the body that carries the sensor) and data of one copy."""
        world = self._world
        if self._shapes is None:
            # Rays pass through the body that carries the sensor: a finger may reach into the housing, before the gel.
            shapes: mujoco.MjModel = copying.copy(world.model)
            shapes.geom_group[self._is_own] = UNFELT_GROUP
            self._shapes = shapes
        model = self._shapes
        for field in FELT_FIELDS:
            values = world.core.expanded(field) if world.leading else None
            shared = getattr(world.model, field)
            getattr(model, field)[:] = shared if values is None else values[copy].reshape(shared.shape)
        if world.data is not None:
            return model, world.data
        if self._poses is None:
            self._poses = mujoco.MjData(model)
        data = self._poses
        mujoco.mj_setState(model, data, world.core.states[copy], mujoco.mjtState.mjSTATE_INTEGRATION.value)
        mujoco.mj_kinematics(model, data)
        return model, data

    def _feel(self, copy: tuple[int, ...], force: float) -> NDArray[np.float32]:
        """Return the gel's displacement in one copy [m], (H, W), under a force [N]."""
        sensor = self.placement.sensor
        least, most = sensor.force_range
        if self._by_force and force <= least:
            return np.zeros(self.gel.rest.shape, np.float32)
        model, data = self._present(copy)
        if not self._is_something_near(model, data):
            return np.zeros(self.gel.rest.shape, np.float32)
        coarse = slice(None, None, COARSER)
        penetration = self.gel.penetration(self._cast(model, data, coarse, coarse, 0.0), COARSER)
        deepest = float(penetration.max())
        if deepest == -np.inf:
            return np.zeros(self.gel.rest.shape, np.float32)
        wanted = deepest
        if self._by_force:
            wanted = sensor.max_indentation * (min(force, most) - least) / (most - least)
        touched = penetration > deepest - wanted
        depth = np.full(self.gel.grid, np.inf)
        if touched.any():
            rows, columns = _around(touched, 1), _around(touched, 0)
            depth[rows, columns] = self._cast(model, data, rows, columns, wanted - deepest)
        return self.gel.displacement(depth)

    def _is_something_near(self, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        """Return whether the bounding box of any geom reaches the gel; most of the time none does."""
        sensor, felt = self.placement.sensor, self._felt
        middle = data.xpos[self._body] + data.xmat[self._body].reshape(3, 3) @ np.array(sensor.gel_center)
        offset = np.einsum("gji,gj->gi", data.geom_xmat[felt].reshape(-1, 3, 3), middle - data.geom_xpos[felt])
        box = model.geom_aabb[felt]
        outside = np.maximum(np.abs(offset - box[:, :3]) - box[:, 3:], 0.0)
        reach = 0.5 * np.hypot(sensor.gel_width, sensor.gel_height) + sensor.max_indentation
        is_near = (outside**2).sum(axis=1) < reach**2
        is_near |= model.geom_type[felt] == mujoco.mjtGeom.mjGEOM_PLANE  # has no box
        return bool(is_near.any())

    def _cast(
        self, model: mujoco.MjModel, data: mujoco.MjData, rows: slice, columns: slice, ahead: float
    ) -> NDArray[np.float64]:
        """Return the depth at which rays meet an object, infinite where there is none [m], (rows, columns).

        Args:
            model: Shapes of all geoms.
            data: Poses of all geoms.
            rows: Rows of the grid of rays.
            columns: Columns of the grid of rays.
            ahead: How far the sensor is moved along its x axis, into the object [m].
        """
        sensor = self.placement.sensor
        rotation = data.xmat[self._body].reshape(3, 3)
        eye = data.xpos[self._body] + rotation @ (np.array(sensor.camera_position) + [ahead, 0.0, 0.0])
        rays = self._rays[rows, columns]
        count = rays.shape[0] * rays.shape[1]
        geoms, depth = np.empty(count, np.int32), np.empty(count)
        # einsum, since the threads of a matrix product cost more than the product when all cores are busy.
        directions = np.einsum("ij,rcj->rci", rotation, rays).ravel()
        # Objects farther from the gel than its indentation do not touch it.
        farthest = sensor.gel_center[0] - sensor.camera_position[0] + 2.0 * sensor.max_indentation
        # MuJoCo culls geoms by distance from the eye, which exceeds the depth towards the corners.
        reach = 2.0 * farthest
        mujoco.mj_multiRay(model, data, eye, directions, self._groups, 1, self._body, geoms, depth, None, count, reach)
        depth[(depth < 0.0) | (depth > farthest)] = np.inf
        return depth.reshape(rays.shape[:2])

    def close(self) -> None:
        """Free the renderer. Closing twice is harmless; reading again makes a new one."""
        self._renderer.close()


def read_force(world: World, placement: TactilePlacement) -> int:
    """Register the normal force on a sensor's gel for readout; return its index in `world.forces`.

    Raises:
        KeyError: The sensor is not in the world.
    """
    is_gel = world.geom_flags([placement.gel_name])
    index = world.core.read_force(is_gel, 1 - is_gel)
    world.refresh()
    return index


def _around(flags: NDArray[np.bool_], across: int) -> slice:
    """Return the rows (across 1) or columns (0) of rays at true flags of coarser ones, with two of these as margin."""
    found = np.flatnonzero(flags.any(axis=across))
    return slice(max(int(found[0]) - 2, 0) * COARSER, (int(found[-1]) + 3) * COARSER)
