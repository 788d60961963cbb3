"""What an environment offers a policy: its observations and actions as named parts with units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from gymnasium import spaces

from rcs.envs.env import Env
from rcs.envs.spaces import FRAMES, GRIPPER, HAND, RGB, TQUAT, TWIST, UNITS, XYZRPY
from rcs.errors import InvalidSetup
from rcs.policy.packages import vlagents
from rcs.policy.units import OPENING, from_unit

if TYPE_CHECKING:
    from vlagents import ImageSpec, Metadata, Offer, PartSpec

MEANINGS = {"absolute": ("absolute", "relative"), "last_step": ("delta",), "origin": ()}
"""What an arm's action may mean to a policy, by `Setup.relative`. Actions that count from where the chunk began become
absolute ones here."""


def key_of(name: str) -> str:
    """Return the key of a part: of `left/joints`, `joints`."""
    return name.rpartition("/")[2]


def unit_of(name: str) -> str:
    """Return our unit of a part."""
    key = key_of(name)
    return OPENING if key in (GRIPPER, HAND) else UNITS.get(key, "")


def flat_boxes(space: spaces.Space[Any], prefix: str = "") -> Iterator[tuple[str, spaces.Box]]:
    """Yield name and space of everything in a space, with `/` between levels; frames are left out."""
    if not isinstance(space, spaces.Dict):
        if isinstance(space, spaces.Box):
            yield prefix, space
        return
    for key, inner in space.spaces.items():
        if key != FRAMES:
            yield from flat_boxes(inner, f"{prefix}/{key}" if prefix else key)


def offer_of(env: Env, metadata: Metadata | None = None) -> Offer:
    """Return what an environment shows and takes.

    Args:
        env: The environment.
        metadata: Of a policy: what is convertible into its units, and into what its actions mean, is offered so.

    Raises:
        MissingDependency: vlagents is not installed.
        InvalidSetup: The environment was put together by hand, without a setup.
    """
    v = vlagents()
    if not env.has_setup:
        raise InvalidSetup("The environment has no setup, which says what its actions mean; make it with rcs.make.")
    state = [
        v.PartSpec(name, box.shape[0], unit_of(name))
        for name, box in flat_boxes(env.observation_space)
        if len(box.shape) == 1
    ]
    names = {part.name for part in state}
    # Roll, pitch and yaw follow from the pose.
    state += [
        v.PartSpec(name[: -len(TQUAT)] + XYZRPY, 6, UNITS[XYZRPY])
        for name in sorted(names)
        if key_of(name) == TQUAT and name[: -len(TQUAT)] + XYZRPY not in names
    ]
    action = [
        v.PartSpec(name, box.shape[0], unit_of(name), _meanings(env, name)[0] if _meanings(env, name) else "relative")
        for name, box in flat_boxes(env.action_space)
    ]
    images = tuple(_images(env.observation_space, v.ImageSpec))
    if metadata is not None:
        state = [_suited(part, _named(metadata.state, part.name), ("absolute",)) for part in state]
        action = [_suited(part, _named(metadata.action, part.name), _meanings(env, part.name)) for part in action]
    return v.Offer(action=tuple(action), images=images, state=tuple(state), has_instruction=bool(env.instruction))


def require_fit(env: Env, metadata: Metadata) -> None:
    """Check that a policy can run in an environment.

    Raises:
        InvalidSetup: It cannot; the message has all differences, a line each.
    """
    v = vlagents()
    found: list[str] = v.differences(metadata, offer_of(env, metadata))
    if env.setup.relative == "origin" and env.setup.control != TWIST:
        found.append("action: the robot counts from an origin that its user sets, which no policy knows")
    if found:
        lines = "\n".join(f"- {line}" for line in found)
        raise InvalidSetup(f"The policy {metadata.name!r} and the environment do not fit:\n{lines}")


def _meanings(env: Env, name: str) -> tuple[str, ...]:
    if key_of(name) in (GRIPPER, HAND, TWIST):
        return ("absolute",)
    return MEANINGS[env.setup.relative]


def _images(space: spaces.Space[Any], spec: type[ImageSpec]) -> Iterator[ImageSpec]:
    frames = space.spaces.get(FRAMES) if isinstance(space, spaces.Dict) else None
    for camera, inner in (frames.spaces if isinstance(frames, spaces.Dict) else {}).items():
        rgb = inner.spaces.get(RGB) if isinstance(inner, spaces.Dict) else None
        if isinstance(rgb, spaces.Box):
            yield spec(camera, rgb.shape[0], rgb.shape[1])


def _named(parts: tuple[PartSpec, ...], name: str) -> PartSpec | None:
    return next((part for part in parts if part.name == name), None)


def _suited(part: PartSpec, wanted: PartSpec | None, meanings: tuple[str, ...]) -> PartSpec:
    """Return a part in the unit and with the meaning that a policy has, where ours can be converted."""
    if wanted is None:
        return part
    changes: Mapping[str, Any] = {}
    if from_unit(wanted.unit, part.unit) is not None:
        changes = {**changes, "unit": wanted.unit}
    if wanted.meaning in meanings:
        changes = {**changes, "meaning": wanted.meaning}
    return replace(part, **changes)
