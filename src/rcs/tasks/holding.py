"""Whether robots hold an object: grasped, touched by nothing else, still in the hand, and for how long."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rcs.envs.layers import CopyIndex
from rcs.sim.robot import SimRobot
from rcs.sim.world import World
from rcs.tasks.lifting import any_of, norm

TOUCH_FORCE = 0.5
"""Least force of a pad that counts as contact with an object [N] (ManiSkill's PickCube)."""
SLIP = 0.01
"""Distance that an object may move in the hand while it counts as held [m]."""


class HoldTimer:
    """Measures in simulated time how long something has been so without a break, for each copy.

    It sees the state at the end of every step, so that a longer step is judged less often, but lasts no less.
    """

    memory = ("since", "_was", "_places")

    def __init__(self, world: World, hold_time: float, tolerance: float = np.inf, places: int = 0) -> None:
        """Start at 0 for a world.

        Args:
            world: The world.
            hold_time: The required time [s].
            tolerance: Distance that the places may move before the time starts anew [m].
            places: Number of places.
        """
        self.since: NDArray[np.float64] = np.zeros(world.leading)
        """Time since which it has been so [s], (*leading,); means nothing where it is not."""
        self._was: NDArray[np.bool_] = np.zeros(world.leading, np.bool_)
        self._places: NDArray[np.float64] = np.full((*world.leading, places, 3), np.inf)
        self._world = world
        self._tolerance = tolerance
        # Simulated time is a sum of many physics steps and has its rounding errors.
        self._enough = hold_time - 0.5 * float(world.model.opt.timestep)

    def reset(self, where: CopyIndex) -> None:
        """Start again for some copies."""
        was = np.array(self._was)  # of one copy it is a number of NumPy's, which is faster than an array
        was[where] = False
        self._was = was

    def count(self, is_so: NDArray[np.bool_], places: NDArray[np.float64] | None = None) -> NDArray[np.bool_]:
        """Look at a new state, and return which copies have been so for long enough, (*leading,).

        Args:
            is_so: Whether it is so now, (*leading,).
            places: Places that must stay where they were when the time began, (*leading, places, 3) [m].
        """
        was, self._was = self._was, is_so.copy()
        if not any_of(is_so):
            return is_so.copy()
        starts = ~was
        if places is not None:
            starts = starts | np.logical_or.reduce(norm(places - self._places) > self._tolerance, axis=-1)
        if any_of(starts):
            if places is not None:
                self._places = np.where(starts[..., None, None], places, self._places)
            self.since = np.where(starts, self._world.time, self.since)
        return is_so & (self._world.time - self.since >= self._enough)


class Grip:
    """The grip of one or several robots on one rigid object, for each copy.

    A gripper grasps the object when each of its two pads presses on it with more than the object's weight, and with
    more than `TOUCH_FORCE`: an object that lies on fingers, on the back of a hand or against an arm does not count.
    """

    memory = ("_least",)

    def __init__(self, world: World, robots: Sequence[SimRobot], name: str) -> None:
        """Register forces and poses for readout.

        Args:
            world: The world, before its first step.
            robots: Robots with a gripper each.
            name: Name of the object's body and of its geom.
        """
        model = world.model
        self._world = world
        self._body = int(model.body(name).id)
        self._gravity = float(np.linalg.norm(model.opt.gravity))
        surface = world.geom_flags([name])
        prefixes = [robot.placement.gripper_prefix for robot in robots]
        pads = [
            world.core.read_force(world.geom_flags(prefix + pad for pad in geoms), surface)
            for prefix, robot in zip(prefixes, robots, strict=True)
            for geoms in robot.gripper.pad_geoms
        ]
        self._pads = slice(pads[0], pads[-1] + 1)  # they are read out one after the other
        bases = [prefix + robot.gripper.base_body for prefix, robot in zip(prefixes, robots, strict=True)]
        self._others = world.core.read_force(all_but(world, *bases, name), surface)
        first, *_ = [world.core.read_body_pose(self._body, model.body(base).id) for base in bases]
        self._in_hands = slice(first, first + len(bases))
        self._least: NDArray[np.float64] = np.zeros(world.leading)

    def reset(self) -> None:
        """Take over the objects' weights, which may vary between episodes."""
        mass = self._world.field("body_mass")[..., self._body]
        self._least = np.maximum(mass * self._gravity, TOUCH_FORCE)

    def grasps(self) -> NDArray[np.bool_]:
        """Return which robots grasp the object, (*leading, robots)."""
        presses = self._world.forces[..., self._pads] > self._least[..., None]
        return presses[..., 0::2] & presses[..., 1::2]

    def is_free(self) -> NDArray[np.bool_]:
        """Return whether nothing but these robots' grippers touches the object, (*leading,)."""
        return self._world.forces[..., self._others] == 0.0

    def places(self) -> NDArray[np.float64]:
        """Return where the object is in the frames of the grippers' bases, (*leading, robots, 3) [m]."""
        return self._world.poses[..., self._in_hands, :3]


def all_but(world: World, *bodies: str) -> NDArray[np.uint8]:
    """Return flags for `World.read_force` of everything but some bodies and what is attached to them."""
    flags = np.ones(world.model.ngeom + world.model.nflex, np.uint8)
    for body in bodies:
        flags &= 1 - world.subtree_flags(body)
    return flags
