"""The interface of environments and policies: named parts with units, whether they fit, and observations as shown."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.env import Env
from rcs.envs.setup import Setup
from rcs.envs.spaces import (
    FINGER_CONTACTS,
    FRAMES,
    GRIPPER,
    HAND,
    IS_GRASPED,
    JOINT_TORQUES,
    JOINTS,
    PRIVILEGED,
    RGB,
    TARGET,
    TCP_WRENCH,
    TQUAT,
    TWIST,
    UNITS,
    XYZRPY,
    Action,
    Control,
    Observation,
    Observed,
)
from rcs.errors import InvalidSetup
from rcs.extras import package_of
from rcs.spatial import tquat_to_xyzrpy

if TYPE_CHECKING:
    import vlagents as v

OPENING = "0 closed, 1 open"
"""Unit of a gripper or a hand here."""
_OPENINGS = {
    OPENING: (1.0, 0.0),
    "0 open, 1 closed": (-1.0, 1.0),
    "1 closed, 0 open": (-1.0, 1.0),
    "1 open, 0 closed": (1.0, 0.0),
    "-1 closed, 1 open": (0.5, 0.5),
    "-1 open, 1 closed": (-0.5, 0.5),
}
_ANGLES = {"rad": (1.0, 0.0), "deg": (math.pi / 180, 0.0)}

MEANINGS = {"absolute": ("absolute", "relative"), "last_step": ("delta",), "origin": ()}
"""Meanings of an arm's action to a policy, by `Setup.relative`. Actions that count from where the chunk began become
absolute ones here."""

OBSERVE_TARGET = "ObserveTarget"
"""The layer that shows the last target."""
_OBSERVED: dict[str, Observed] = {
    JOINT_TORQUES: "torques", TCP_WRENCH: "wrench", FINGER_CONTACTS: "contacts", IS_GRASPED: "contacts",
}  # fmt: skip


def vlagents(module: str = "vlagents") -> Any:
    """Import and return `vlagents`, or a module of it.

    Raises:
        MissingDependency: It is not installed; the message names the extra.
    """
    return package_of("policy", module, "Policies at an address need")


def key_of(name: str) -> str:
    """Return the key of a part: `joints` for `left/joints`."""
    return name.rpartition("/")[2]


def unit_of(name: str) -> str:
    """Return our unit of a part."""
    key = key_of(name)
    return OPENING if key in (GRIPPER, HAND) else UNITS.get(key, "")


def from_unit(unit: str, ours: str) -> tuple[float, float] | None:
    """Return scale and offset that take a number in a policy's unit to ours; None if they are not convertible.

    Args:
        unit: The policy's; empty for ours.
        ours: The environment's.
    """
    if unit in ("", ours) or ours == "":
        return 1.0, 0.0
    return {OPENING: _OPENINGS, "rad": _ANGLES}.get(ours, {}).get(unit)


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the arrays of nested dictionaries by name, with `/` between levels."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{prefix}/{key}" if prefix else key
        found.update(flat(value, name) if isinstance(value, Mapping) else {name: value})
    return found


def flat_boxes(space: spaces.Space[Any], prefix: str = "") -> Iterator[tuple[str, spaces.Box]]:
    """Yield name and space of everything in a space, with `/` between levels; frames are left out."""
    if isinstance(space, spaces.Box):
        yield prefix, space
    for key, inner in space.spaces.items() if isinstance(space, spaces.Dict) else ():
        if key != FRAMES:
            yield from flat_boxes(inner, f"{prefix}/{key}" if prefix else key)


def nested(values: Mapping[str, NDArray[Any]], boxes: Mapping[str, spaces.Box]) -> Action:
    """Return arrays by name as an action, inside the bounds."""
    action: Action = {}
    for name, box in boxes.items():
        robot, _, key = name.rpartition("/")
        value = np.clip(values[name], box.low, box.high).astype(box.dtype)
        (action.setdefault(robot, {}) if robot else action)[key] = value
    return action


# --- Whether they fit -------------------------------------------------------------------------------------------------


def offer_of(env: Env, metadata: v.Metadata | None = None, instruction: str | None = None) -> v.Offer:
    """Return the observations and actions that an environment offers a policy.

    Args:
        env: The environment.
        metadata: The metadata of a policy, into whose units and meanings everything convertible is converted.
        instruction: The instruction for the policy; None for the environment's.

    Raises:
        MissingDependency: vlagents is not installed.
        InvalidSetup: The environment was put together by hand, without a setup.
    """
    v = vlagents()
    if not env.has_setup:
        raise InvalidSetup("The environment has no setup, which says what its actions mean; make it with rcs.make.")
    boxes = flat_boxes(env.observation_space)
    state = [v.PartSpec(name, box.shape[0], unit_of(name)) for name, box in boxes if len(box.shape) == 1]
    names = {part.name for part in state}
    # Roll, pitch and yaw follow from the pose.
    state += [
        v.PartSpec(rpy, 6, UNITS[XYZRPY])
        for name in sorted(names)
        if key_of(name) == TQUAT and (rpy := name.removesuffix(TQUAT) + XYZRPY) not in names
    ]
    action = [
        v.PartSpec(name, box.shape[0], unit_of(name), next(iter(_meanings(env, name)), "relative"))
        for name, box in flat_boxes(env.action_space)
    ]
    frames = env.observation_space.spaces.get(FRAMES) if isinstance(env.observation_space, spaces.Dict) else None
    images = [
        v.ImageSpec(camera, *rgb.shape[:2])
        for camera, inner in (frames.spaces if isinstance(frames, spaces.Dict) else {}).items()
        if isinstance(inner, spaces.Dict) and isinstance(rgb := inner.spaces.get(RGB), spaces.Box)
    ]
    if metadata is not None:
        state = [_converted(part, metadata.state, ("absolute",)) for part in state]
        action = [_converted(part, metadata.action, _meanings(env, part.name)) for part in action]
    return v.Offer(
        action=tuple(action),
        images=tuple(images),
        state=tuple(state),
        has_instruction=bool(env.instruction if instruction is None else instruction),
        has_goal=False,
    )


def require_fit(env: Env, metadata: v.Metadata, instruction: str | None = None) -> None:
    """Check that a policy can run in an environment.

    Args:
        env: The environment.
        metadata: The metadata of the policy.
        instruction: The instruction for it; None for the environment's.

    Raises:
        InvalidSetup: It cannot; the message has all differences, a line each.
    """
    found: list[str] = vlagents().differences(metadata, offer_of(env, metadata, instruction))
    if env.setup.relative == "origin" and env.setup.control != TWIST:
        found.append("action: the robot counts from an origin that its user sets, which no policy knows")
    found += _unmeasured(env)
    if found:
        lines = "\n".join(f"- {line}" for line in found)
        raise InvalidSetup(f"The policy {metadata.name!r} and the environment do not fit:\n{lines}")


def _unmeasured(env: Env) -> Iterator[str]:
    """Yield a sentence for each part of an action that starts and holds where it is measured, and is not shown."""
    shown = {name for name, _ in flat_boxes(env.observation_space)}
    for name, _ in flat_boxes(env.action_space):
        key = key_of(name)
        wanted = name.removesuffix(XYZRPY) + TQUAT if key == XYZRPY else name
        is_target = key == HAND or (env.setup.relative == "absolute" and key in (JOINTS, TQUAT, XYZRPY))
        if is_target and wanted not in shown:
            yield (
                f"state: {name!r} starts and holds where it is measured, and the robot does not show {wanted!r}; have "
                "it observed, in a simulator of another project by the mapping"
            )


def _meanings(env: Env, name: str) -> tuple[str, ...]:
    return ("absolute",) if key_of(name) in (GRIPPER, HAND, TWIST) else MEANINGS[env.setup.relative]


def _converted(part: v.PartSpec, wanted: tuple[v.PartSpec, ...], meanings: tuple[str, ...]) -> v.PartSpec:
    """Return a part in the unit and with the meaning that a policy has, where ours can be converted."""
    its = next((one for one in wanted if one.name == part.name), part)
    unit = its.unit if from_unit(its.unit, part.unit) is not None else part.unit
    return replace(part, unit=unit, meaning=its.meaning if its.meaning in meanings else part.meaning)


def fitted(setup: Setup, metadata: v.Metadata, given: Collection[str] = ()) -> Setup:
    """Return a setup with the control, the cameras, the image size and the observations that a policy names.

    Args:
        setup: Everything else.
        metadata: The metadata of the policy.
        given: Names among `control`, `relative`, `cameras` and `image_size` that stay as they are.
    """
    changes: dict[str, Any] = {}
    arm = next((part for part in metadata.action if key_of(part.name) in get_args(Control)), None)
    if arm is not None:
        changes["control"] = key_of(arm.name)
        is_absolute = arm.meaning != "delta" and changes["control"] != TWIST
        changes["relative"] = "absolute" if is_absolute else "last_step"
    cameras: dict[str, Any] = {}
    if metadata.action:
        cameras["names"] = tuple(image.name for image in metadata.images)
    sizes = {image.name: (image.width, image.height) for image in metadata.images if image.width and image.height}
    if len(set(sizes.values())) == 1:
        cameras["image_size"] = next(iter(sizes.values()))
    elif sizes and "names" in cameras and "cameras" not in given:
        cameras["image_size"] = sizes
    parts = [part.name for part in metadata.state]
    observed = ["privileged" if PRIVILEGED in name.split("/") else _OBSERVED.get(key_of(name)) for name in parts]
    changes["observe"] = tuple(dict.fromkeys([*setup.observe, *(one for one in observed if one is not None)]))
    if any(TARGET in name.split("/") for name in parts) and OBSERVE_TARGET not in setup.layers:
        changes["layers"] = (*setup.layers, OBSERVE_TARGET)
    changes = {name: value for name, value in changes.items() if name not in given}
    cameras = {name: own for name, own in cameras.items() if {"names": "cameras"}.get(name, name) not in given}
    return replace(setup, **changes, cameras=replace(setup.cameras, **cameras))


# --- Observations -----------------------------------------------------------------------------------------------------


def policy_observation(
    observation: Observation, needs: v.Metadata, *, time: float, instruction: str, session: str
) -> v.Observation:
    """Return an observation as a policy sees it: what its metadata name, or all that a robot has where they name none.

    Args:
        observation: An observation of the environment.
        needs: The metadata of the policy.
        time: The time of the observation [s].
        instruction: The instruction.
        session: The policy's session for this robot.
    """
    values = flat({key: value for key, value in observation.items() if key != FRAMES})
    frames = observation.get(FRAMES, {})
    if needs.images or needs.state:
        cameras = [image.name for image in needs.images]
        state = {part.name: _in_unit(part.unit, part.name, values) for part in needs.state}
    else:
        cameras = [name for name in frames if RGB in frames[name]]
        state = {name: np.asarray(own, np.float64) for name, own in values.items() if PRIVILEGED not in name.split("/")}
    seen: v.Observation = vlagents().Observation(
        images={name: frames[name][RGB] for name in cameras},
        state=state,
        instruction=instruction,
        time=time,
        session=session,
    )
    return seen


def _in_unit(unit: str, name: str, values: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return an observed value in a policy's unit; roll, pitch and yaw from the pose."""
    is_rpy = name not in values and key_of(name) == XYZRPY
    value = tquat_to_xyzrpy(values[name.removesuffix(XYZRPY) + TQUAT]) if is_rpy else values[name]
    scale, offset = from_unit(unit, unit_of(name)) or (1.0, 0.0)
    return (np.asarray(value, np.float64) - offset) / scale
