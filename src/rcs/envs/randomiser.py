"""Randomises the models of all copies at once at the start of episodes.

Draws always apply to nominal values, so that an episode does not depend on the one before. They depend only on seed and
episode, in streams separate from the task's: replays repeat them, and they do not change how a task starts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs.draws import Draws
from rcs.sim.model_rows import ModelRows, ObjectParts, colours, owners
from rcs.sim.randomisation import Randomisation
from rcs.sim.scene import TABLE, CameraPlacement, RobotPlacement
from rcs.sim.textures import texture_name
from rcs.sim.world import Copies, World
from rcs.spatial import compose, normalize, wxyz_to_xyzw, xyzw_to_wxyz

Values = NDArray[np.float64]
Write = Callable[[dict[str, Values], Copies], None]


class Randomiser:
    """Varies one world from episode to episode."""

    memory = ("values",)

    def __init__(
        self,
        world: World,
        ranges: Randomisation,
        *,
        objects: Sequence[str] = (),
        robots: Sequence[RobotPlacement] = (),
        cameras: Sequence[CameraPlacement] = (),
    ) -> None:
        """Look up what varies, and take its present values as nominal.

        Args:
            world: A world fresh from its model.
            ranges: Ranges of the draws.
            objects: Names of the task's bodies.
            robots: Robots of its scene.
            cameras: Cameras of its scene.

        Raises:
            KeyError: An object is not in the model.
        """
        self._world = world
        self._ranges = ranges
        self._bounds: dict[str, tuple[Values, Values]] = {}
        self._writes: list[Write] = []
        self._changes_constants = False
        self.names: dict[str, tuple[str, ...]] = {}
        """What the rows of each field's values belong to, in order."""
        self._add_lights()
        self._add_surfaces()
        self._add_objects([ObjectParts(world, name) for name in objects], objects)
        self._add_cameras(cameras)
        self._add_contacts_and_joints(robots)
        self.values: dict[str, NDArray[np.float64]] = {
            field: np.zeros(world.leading + low.shape) for field, (low, _) in self._bounds.items()
        }
        """The draws of the present episodes, by field of `Randomisation`: (*leading, ...), replaced as a whole."""

    def begin(self, draws: Draws, copies: Copies = None) -> None:
        """Draw and write the values of some copies' next episodes.

        Args:
            draws: Random numbers for exactly these copies; they are not advanced.
            copies: Which copies; None for all.
        """
        if not self._bounds:
            return
        streams = draws.branch("randomisation")
        drawn: dict[str, Values] = {}
        for field, (low, high) in self._bounds.items():
            drawn[field] = streams.branch(field).uniform(low, high)
            if field == "textures":
                drawn[field] = np.floor(drawn[field])
        if copies is None:
            self.values = drawn
        else:
            self.values = {field: values.copy() for field, values in self.values.items()}
            for field, values in drawn.items():
                self.values[field][copies] = values
        self.apply(copies)

    def apply(self, copies: Copies = None) -> None:
        """Write the present `values` of some copies into the world again, after they were set."""
        where = ... if copies is None else copies
        drawn = {field: values[where] if self._world.leading else values for field, values in self.values.items()}
        for write in self._writes:
            write(drawn, copies)
        if self._changes_constants:
            self._world.update_constants(copies)

    def _draw(self, field: str, shape: tuple[int, ...], names: Sequence[str] = ()) -> bool:
        """Enable a field if its range has a width and there is something to vary; return whether."""
        if not self._ranges.varies(field) or 0 in shape:
            return False
        low, high = self._ranges.bounds(field)
        self._bounds[field] = np.full(shape, low), np.full(shape, high)
        self.names[field] = tuple(names)
        return True

    def _add_lights(self) -> None:
        model = self._world.model
        names = [model.light(i).name for i in range(model.nlight)]
        lights = np.arange(model.nlight)
        if self._draw("light_intensity", (model.nlight,), names):
            parts = ("light_ambient", "light_diffuse", "light_specular")
            brightness = [ModelRows(self._world, part, lights) for part in parts]

            def write_brightness(drawn: dict[str, Values], copies: Copies) -> None:
                for rows in brightness:
                    rows.scale(drawn["light_intensity"], copies)

            self._writes.append(write_brightness)
        if self._draw("light_direction", (model.nlight, 3), names):
            directions = ModelRows(self._world, "light_dir", lights)
            self._writes.append(
                lambda drawn, copies: directions.write(_turned(directions.nominal, drawn["light_direction"]), copies)
            )
        if self._draw("light_position", (model.nlight, 3), names):
            positions = ModelRows(self._world, "light_pos", lights)
            self._writes.append(
                lambda drawn, copies: positions.write(positions.nominal + drawn["light_position"], copies)
            )

    def _add_surfaces(self) -> None:
        world, model = self._world, self._world.model
        room = [i for i in np.flatnonzero(model.geom_bodyid == 0) if model.geom(i).name]
        if self._draw("room_colour", (len(room), 3), [model.geom(i).name for i in room]):
            self._add_colour("room_colour", [np.array([i]) for i in room])
        try:
            table = np.flatnonzero(world.subtree(TABLE)[model.geom_bodyid])
        except KeyError:
            return
        top = np.array([i for i in table if model.geom(i).name], np.intp)
        if self._draw("textures", (1,) if len(top) else (0,), ["0: its own look", *self._texture_names()]):
            looks = [int(model.material(name).id) for name in self._texture_names()]
            materials, own_colour = ModelRows(world, "geom_matid", top), ModelRows(world, "geom_rgba", top)
            own_colour.write(colours(world, top))
            choices = np.column_stack([materials.nominal, *(np.full(len(top), look) for look in looks)])
            self._writes.append(
                lambda drawn, copies: materials.write(
                    choices[np.arange(len(top)), drawn["textures"].astype(np.intp)], copies
                )
            )
        if self._draw("table_colour", (1, 3), [TABLE]):
            self._add_colour("table_colour", [table])

    def _texture_names(self) -> list[str]:
        return [texture_name(i) for i in range(self._ranges.textures)]

    def _add_colour(self, field: str, groups: Sequence[NDArray[np.intp]], *, flexes: bool = False) -> None:
        """Shift the colours of groups of geoms or flexes, each group by the same amount."""
        members, group = np.concatenate(groups), owners(groups)
        if not len(members):
            return
        rows = ModelRows(self._world, "flex_rgba" if flexes else "geom_rgba", members)
        nominal = (rows.nominal if flexes else colours(self._world, members)).astype(np.float64)

        def write(drawn: dict[str, Values], copies: Copies) -> None:
            shift = drawn[field][..., group, :]
            rgba = np.empty((*shift.shape[:-1], 4))
            rgba[..., :3] = np.clip(nominal[:, :3] + shift, 0.0, 1.0)
            rgba[..., 3] = nominal[:, 3]
            rows.write(rgba, copies)

        self._writes.append(write)

    def _add_objects(self, parts: Sequence[ObjectParts], names: Sequence[str]) -> None:
        coloured = [i for i, part in enumerate(parts) if len(part.geoms) or len(part.flexes)]
        if self._draw("object_colour", (len(coloured), 3), [names[i] for i in coloured]):
            self._add_colour("object_colour", [parts[i].geoms for i in coloured])
            self._add_colour("object_colour", [parts[i].flexes for i in coloured], flexes=True)
        scalable = [i for i, part in enumerate(parts) if part.is_scalable]
        has_size = self._draw("object_size", (len(scalable),), [names[i] for i in scalable])
        has_mass = self._draw("object_mass", (len(parts),), names)
        if has_size:
            self._add_sizes([parts[i] for i in scalable])
        if not (has_size or has_mass):
            return
        self._changes_constants = True
        bodies = [part.bodies for part in parts]
        owner = owners(bodies)
        masses = ModelRows(self._world, "body_mass", np.concatenate(bodies)) if has_mass else None
        inertias = ModelRows(self._world, "body_inertia", np.concatenate(bodies))

        def write(drawn: dict[str, Values], copies: Copies) -> None:
            leading = drawn["object_mass" if has_mass else "object_size"].shape[:-1]
            factor = np.ones((*leading, len(parts)))
            if has_size:
                factor[..., scalable] *= drawn["object_size"] ** 2
            if masses is not None:
                factor *= drawn["object_mass"]
                masses.scale(drawn["object_mass"][..., owner], copies)
            inertias.scale(factor[..., owner], copies)

        self._writes.append(write)

    def _add_sizes(self, parts: Sequence[ObjectParts]) -> None:
        """Scale shapes about the root's frame, including their bounds."""
        geoms = [part.geoms for part in parts]
        fields = {
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
        scaled = [
            (ModelRows(self._world, field, np.concatenate(rows)), owners(rows))
            for field, rows in fields.items()
            if sum(map(len, rows))
        ]

        def write(drawn: dict[str, Values], copies: Copies) -> None:
            for rows, owner in scaled:
                rows.scale(drawn["object_size"][..., owner], copies)

        self._writes.append(write)
        nodes = [part.nodes for part in parts]
        if sum(map(len, nodes)):
            self._add_nodes_at_rest(parts, nodes)

    def _add_nodes_at_rest(self, parts: Sequence[ObjectParts], nodes: Sequence[NDArray[np.intp]]) -> None:
        """Scale where the nodes of soft bodies are when nothing pulls at them, which the model has in the scene."""
        at_rest = mujoco.MjData(self._world.model)
        mujoco.mj_kinematics(self._world.model, at_rest)
        owner = owners(nodes)
        center = at_rest.xpos[[part.root for part in parts]][owner]
        rows = ModelRows(self._world, "flex_node0", np.concatenate(nodes))
        offset = rows.nominal - center

        def write(drawn: dict[str, Values], copies: Copies) -> None:
            rows.write(center + offset * drawn["object_size"][..., owner, None], copies)

        self._writes.append(write)

    def _add_cameras(self, cameras: Sequence[CameraPlacement]) -> None:
        world, model = self._world, self._world.model
        names = [camera.name for camera in cameras]
        moves = [self._draw(field, (len(cameras), 3), names) for field in ("camera_translation", "camera_rotation")]
        if any(moves):
            self._changes_constants = True
            # Moves the camera's body, whose frame is the optical one, so that the housing never gets into the view.
            bodies = [model.body(f"{camera.name}/{camera.camera.base_body}").id for camera in cameras]
            positions, quaternions = ModelRows(world, "body_pos", bodies), ModelRows(world, "body_quat", bodies)
            nominal = np.concatenate([positions.nominal, wxyz_to_xyzw(quaternions.nominal)], axis=-1)

            def write_poses(drawn: dict[str, Values], copies: Copies) -> None:
                jitter = _small_pose(drawn.get("camera_translation"), drawn.get("camera_rotation"))
                poses = compose(np.broadcast_to(nominal, jitter.shape), jitter)
                positions.write(poses[..., :3], copies)
                quaternions.write(xyzw_to_wxyz(poses[..., 3:]), copies)

            self._writes.append(write_poses)
        if self._draw("field_of_view", (len(cameras),), names):
            ids = [model.camera(camera.camera_name).id for camera in cameras]
            angles, intrinsics = ModelRows(world, "cam_fovy", ids), ModelRows(world, "cam_intrinsic", ids)

            def write_views(drawn: dict[str, Values], copies: Copies) -> None:
                factor = drawn["field_of_view"]
                angles.scale(factor, copies)
                # Cameras with a sensor size use a focal length, which falls as the angle grows.
                focal = np.ones((*factor.shape, 4))
                focal[..., :2] = 1.0 / factor[..., None]
                intrinsics.write(intrinsics.nominal * focal, copies)

            self._writes.append(write_views)

    def _add_contacts_and_joints(self, robots: Sequence[RobotPlacement]) -> None:
        world, model = self._world, self._world.model
        if self._draw("friction", (1,)):
            counts = {"geom_friction": model.ngeom, "flex_friction": model.nflex, "pair_friction": model.npair}
            frictions = [ModelRows(world, field, np.arange(count)) for field, count in counts.items() if count]

            def write_frictions(drawn: dict[str, Values], copies: Copies) -> None:
                factor = drawn["friction"]
                for rows in frictions:
                    rows.scale(np.broadcast_to(factor, (*factor.shape[:-1], len(rows.rows))), copies)

            self._writes.append(write_frictions)
        is_robots = np.zeros(model.nbody, np.bool_)
        for robot in robots:
            is_robots |= world.subtree(robot.base_body)
        dofs = np.flatnonzero(is_robots[model.dof_bodyid] & (model.dof_damping > 0))
        if self._draw("joint_damping", (len(dofs),), [model.joint(model.dof_jntid[i]).name for i in dofs]):
            dampings = ModelRows(world, "dof_damping", dofs)
            self._writes.append(lambda drawn, copies: dampings.scale(drawn["joint_damping"], copies))


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
