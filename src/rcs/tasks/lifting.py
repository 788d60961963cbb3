"""Shared parts of tasks in which an object on the table is lifted and held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs.layers import Where
from rcs.envs.task import Task
from rcs.errors import InvalidSetup
from rcs.sim.scene import Scene
from rcs.sim.world import World
from rcs.spatial import xyzw_to_wxyz


@dataclass(frozen=True, kw_only=True)
class LiftOptions(Task.Options):
    """Options of a task of lifting and holding."""

    lift_height: float = 0.10
    """Height above its start at which the object must be held [m]."""
    hold_time: float = 1.0
    """How long it must be held [s]."""

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            InvalidSetup: A value is not a number above 0.
        """
        super().__post_init__()
        for name in ("lift_height", "hold_time"):
            if not getattr(self, name) > 0:
                raise InvalidSetup(f"The task option {name} is {getattr(self, name)!r}; valid is a number above 0.")


class HoldCounter:
    """Counts how many steps in a row something was held, for each copy."""

    memory = ("steps",)

    def __init__(self, world: World, hold_time: float) -> None:
        """Count from 0 for a world; `hold_time` is the required time [s]."""
        self.steps: NDArray[np.int64] = np.zeros(world.leading, np.int64)
        """Steps in a row so far, (*leading,)."""
        self._enough = max(1, round(hold_time * world.frequency))

    def reset(self, where: Where) -> None:
        """Start again for some copies."""
        steps = np.array(self.steps)  # of one copy it is a number of NumPy's, which is faster than an array
        steps[where] = 0
        self.steps = steps

    def count(self, is_held: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Count a step, and return which copies have held for long enough, (*leading,)."""
        self.steps = (self.steps + 1) * is_held
        return self.steps >= self._enough


class FreeBody:
    """A free body whose joint and geom share its name."""

    def __init__(self, world: World, name: str) -> None:
        """Look up its place in the state."""
        self._qpos = world.qpos
        first = int(world.model.joint(name).qposadr[0])
        self._translation = slice(first, first + 3)
        self._quaternion = slice(first + 3, first + 7)

    def place(self, pose: NDArray[np.float64], where: Where) -> None:
        """Put the bodies of some copies at poses in the scene, (*leading of these, 7) [m], xyzw."""
        self._qpos[where, self._translation] = pose[..., :3]
        self._qpos[where, self._quaternion] = xyzw_to_wxyz(pose[..., 3:])


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
        # Sliding friction of PLA or wood on rubber is about 1. Torsional friction, which needs condim 4, keeps a box
        # from turning between the pads.
        friction=[1.0, 0.01, 0.0001],
        condim=4,
        solref=[0.01, 1.0],
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


def progress(
    distance: NDArray[np.float64], is_grasped: NDArray[np.bool_], height: NDArray[np.float64], lift_height: float
) -> NDArray[np.float64]:
    """Return the mean of reaching, grasping, and lifting while grasping, 0 … 1 each (ManiSkill 3's PickCube-v1).

    Args:
        distance: Distance from the TCP to the grasp point [m].
        is_grasped: Whether the object is grasped.
        height: Height of the object above its start [m].
        lift_height: Required height [m].
    """
    reach = 1.0 - np.tanh(5.0 * distance)
    lift = np.minimum(np.maximum(height * (1.0 / lift_height), 0.0), 1.0)
    return (reach + is_grasped * (1.0 + lift)) * (1.0 / 3.0)


# The order of NumPy's sums may depend on the number of copies.
def norm(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths of vectors (..., 3), with the same bits for one copy as for many."""
    x, y, z = (vectors[..., i] for i in range(3))
    return np.sqrt(x * x + y * y + z * z)
