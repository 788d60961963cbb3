"""Shared parts of tasks in which an object on the table is lifted and held."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray
from rcs_data.options import Positive

from rcs.envs.task import Task
from rcs.sim.scene import TABLE, Scene
from rcs.sim.world import World


class LiftOptions(Task.Options):
    """Options of a task of lifting and holding."""

    lift_height: Positive = 0.10
    """Height above the table at which the whole object must be held: that of its lowest point [m]."""
    hold_time: Positive = 1.0
    """How long the object must be held without a break [s], in simulated time."""


def add_box(
    scene: Scene, name: str, place: tuple[float, float], *, edges: Sequence[float], mass: float, rgb: Sequence[float]
) -> None:
    """Add a free box on the table.

    Args:
        scene: The scene, before it is compiled.
        name: Name of its body, joint and geom.
        place: x, y of its middle in the scene [m].
        edges: Edges along its x, y, z [m].
        mass: Its mass [kg].
        rgb: Its colour, 0 … 1.
    """
    body = scene.spec.worldbody.add_body(name=name, pos=[*place, edges[2] / 2])
    body.add_freejoint(name=name)
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[edge / 2 for edge in edges],
        mass=mass,
        rgba=[*rgb, 1.0],
        # Sliding friction on rubber: our choice for PLA and wood. MuJoCo takes the greater of two bodies' coefficients;
        # pads and tables have smaller ones, so that an object's is that of its contacts. Torsional friction, which
        # needs condim 4, keeps a box from turning between the pads. The time constant is the pads', the shortest that
        # a physics step of 2 ms allows: a box that falls by 30 cm sinks in by 4 mm. Twice the critical damping keeps
        # a bar between two arms from rattling.
        friction=[1.0, 0.01, 0.0001],
        condim=4,
        solref=[0.004, 2.0],
        group=0,
    )


def upright(place: NDArray[np.float64], height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return poses (*leading, 7) turned only about the vertical.

    Args:
        place: x, y [m] and yaw [rad], (*leading, 3).
        height: z [m], (*leading,).
    """
    pose = np.zeros((*place.shape[:-1], 7))
    pose[..., :2] = place[..., :2]
    pose[..., 2] = height
    pose[..., 5], pose[..., 6] = np.sin(place[..., 2] / 2), np.cos(place[..., 2] / 2)
    return pose


def table_height(world: World) -> NDArray[np.float64]:
    """Return the height of the table's top in the scene [m], (*leading,)."""
    return world.field("body_pos")[..., world.model.body(TABLE).id, 2]


def lowest(pose: NDArray[np.float64], half_edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height of the lowest corner of a box [m], (*leading,).

    Args:
        pose: Pose of its middle, (*leading, 7) [m], xyzw.
        half_edges: Half its edges along its x, y, z [m], (*leading, 3).
    """
    height, x, y, z, w = pose.T[2:]  # numbers for one copy, which are faster than arrays
    half_x, half_y, half_z = half_edges.T
    down = np.abs(2 * (x * z - w * y)) * half_x + np.abs(2 * (y * z + w * x)) * half_y
    return (height - down - np.abs(1 - 2 * (x * x + y * y)) * half_z).T


def progress(
    distance: NDArray[np.float64], is_grasped: NDArray[np.bool_], lifted: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the mean of reaching, grasping, and lifting while grasping, 0 … 1 each.

    These are the terms of ManiSkill 3's PickCube-v1. There, lifting counts as reaching does, by `1 - tanh(5 d)` of the
    missing height d. The first of ten centimetres then earn less than an object that slips away may cost, and learners
    hardly dared to lift. Here, each earns as much; and reaching distinguishes the last centimetres.

    Args:
        distance: Distance from the TCP to the grasp point [m].
        is_grasped: Whether the object is grasped.
        lifted: Share of the height that is wanted; it counts from 0 to 1.
    """
    return (nearness(distance) + is_grasped * (1.0 + np.minimum(np.maximum(lifted, 0.0), 1.0))) * (1.0 / 3.0)


def nearness(distance: NDArray[np.float64], steepness: float = 5.0) -> NDArray[np.float64]:
    """Return how near an object is to its goal, 0 … 1: half coarsely and half finely.

    The fine half is our addition to ManiSkill 3's `1 - tanh(5 d)`: where an object must lie within 2 or 3 cm of its
    goal, it distinguishes the last centimetres.

    Args:
        distance: Distance from the goal [m].
        steepness: Steepness of the coarse half [1/m].
    """
    return 1.0 - 0.5 * (np.tanh(steepness * distance) + np.tanh(25.0 * distance))


def any_of(flags: NDArray[np.bool_]) -> bool:
    """Return `flags.any()`, ten times as fast for a number of NumPy's."""
    return bool(flags.any() if flags.ndim else flags)


# The order of NumPy's sums may depend on the number of copies.
def norm(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths of vectors (..., 3), with the same bits for one copy as for many."""
    x, y, z = vectors.T  # numbers for one vector, which are faster than arrays
    return np.sqrt(x * x + y * y + z * z).T
