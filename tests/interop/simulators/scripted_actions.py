"""Scripted policies, which see what simulators show and answer with the way of the TCP; all of them without memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from vlagents import Metadata, Observation, PartSpec

ARM = (PartSpec("xyzrpy", 6, "m, rad", "delta"), PartSpec("gripper", 1, "0 closed, 1 open"))
HAND = (PartSpec("tquat", 7, "m, xyzw"), PartSpec("gripper", 1, "0 closed, 1 open"))


def metadata(name: str, rate: float, *objects: str) -> Metadata:
    """Return what a script needs: the hand, and the poses or positions of objects."""
    sizes = {"tquat": 7, "goal_pos": 3}
    parts = [PartSpec(f"privileged/{one}", sizes[one.rpartition("/")[2]]) for one in objects]
    return Metadata(name=name, state=(*HAND, *parts), action=ARM, rate=rate)


def place(observation: Observation, name: str) -> NDArray[np.float64]:
    """Return where something is [m]."""
    return observation.state[f"privileged/{name}"][:3]


def yaw(quaternion: NDArray[np.float64]) -> float:
    """Return by how much the x axis is turned about the vertical [rad]."""
    x, y, z, w = quaternion
    return float(np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)))


def go(
    observation: Observation, target: NDArray[np.float64], opening: float, most: float, turn: float = 0.0
) -> NDArray[np.float64]:
    """Return the action that goes to a place, and turns about the vertical."""
    way = np.clip(target - observation.state["tquat"][:3], -most, most)
    return np.array([*way, 0.0, 0.0, np.clip(turn, -0.1, 0.1), opening])


def pick_and_place(
    observation: Observation,
    thing: NDArray[np.float64],
    goal: NDArray[np.float64],
    *,
    angle: float,
    width: float,
    lift: float,
    most: float,
) -> NDArray[np.float64]:
    """Return the next action: above the thing, down, close, up, above the goal, down, and leave it there.

    Args:
        observation: It has the hand.
        thing: Where to grasp [m].
        goal: Where that is to be in the end [m].
        angle: How the thing is turned about the vertical [rad].
        width: Opening below which the thing is held.
        lift: How high to go in between [m].
        most: Longest way of a step [m].
    """
    hand, opening = observation.state["tquat"][:3], float(observation.state["gripper"][0])
    up = np.array([0.0, 0.0, lift])
    # The fingers go to two sides of a cube: they are a quarter of a turn apart.
    turn = (angle - yaw(observation.state["tquat"][3:]) + np.pi / 4) % (np.pi / 2) - np.pi / 4
    is_placed = np.linalg.norm(thing[:2] - goal[:2]) < 0.015 and abs(thing[2] - goal[2]) < 0.006
    if is_placed:
        return go(observation, thing + up if opening > 0.9 else thing, 1.0, most)
    if (np.linalg.norm(hand[:2] - thing[:2]) > 0.01 or abs(turn) > 0.05) and opening > width:
        return go(observation, thing + up, 1.0, most, turn)
    if hand[2] - thing[2] > 0.01 and opening > width:
        return go(observation, thing, 1.0, most)
    if opening > width:
        return go(observation, thing, 0.0, most)
    if np.linalg.norm(thing[:2] - goal[:2]) > 0.01:
        is_low = thing[2] < goal[2] + lift / 2 and np.linalg.norm(thing[:2] - goal[:2]) > 0.03
        return go(observation, hand + up if is_low else np.array([*goal[:2], goal[2] + lift]) + hand - thing, 0.0, most)
    return go(observation, goal + hand - thing, 0.0, most)


def pick_cube(observation: Observation, instruction: str) -> NDArray[np.float64]:
    """ManiSkill's PickCube: the cube goes to a place in the air, and stays in the hand."""
    thing, goal = place(observation, "obj/tquat"), place(observation, "goal_pos")
    if float(observation.state["gripper"][0]) < 0.6 and np.linalg.norm(observation.state["tquat"][:3] - thing) < 0.03:
        return go(observation, observation.state["tquat"][:3] + goal - thing, 0.0, 0.05)
    angle = yaw(observation.state["privileged/obj/tquat"][3:])
    return pick_and_place(observation, thing, goal, angle=angle, width=0.6, lift=0.1, most=0.05)


def stack_cube(observation: Observation, instruction: str) -> NDArray[np.float64]:
    """ManiSkill's StackCube: a cube of 4 cm goes onto another."""
    goal = place(observation, "cubeB/tquat") + [0.0, 0.0, 0.04]
    thing, angle = place(observation, "cubeA/tquat"), yaw(observation.state["privileged/cubeA/tquat"][3:])
    return pick_and_place(observation, thing, goal, angle=angle, width=0.6, lift=0.1, most=0.05)


def put_into_basket(observation: Observation, instruction: str) -> NDArray[np.float64]:
    """LIBERO's libero_object: the thing that the instruction names is let fall into a basket."""
    name = instruction.removeprefix("pick up the ").partition(" and ")[0].replace(" ", "_")
    thing, goal = place(observation, f"{name}_1/tquat"), place(observation, "basket_1/tquat") + [0.0, 0.0, 0.12]
    angle = yaw(observation.state[f"privileged/{name}_1/tquat"][3:])
    return pick_and_place(observation, thing, goal, angle=angle, width=0.95, lift=0.1, most=0.05)
