"""The needs and answers of a policy, the offer of a robot, and the differences between the two."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from vlagents.errors import InvalidInput
from vlagents.record import Count, Hertz, Name, Record

Meaning = Literal["absolute", "relative", "delta"]
"""An action is a target, or a motion from where the chunk began, or a motion from the action before."""
Pixels = Annotated[int, Meta(ge=0, le=1_000_000)]


@dataclass(frozen=True)
class ImageSpec(Record):
    """A camera's image."""

    name: Name
    """Name of the camera, as in `Observation.images`."""
    height: Pixels = 0
    """Height [pixels]; 0 for any."""
    width: Pixels = 0
    """Width [pixels]; 0 for any."""


@dataclass(frozen=True)
class PartSpec(Record):
    """A part of the robot's state, or of an action."""

    name: Name
    """Its name: `joints`, `tquat`, `xyzrpy`, `gripper`, `hand`, or another."""
    size: Count
    """Number of numbers."""
    unit: str = ""
    """Unit of its numbers: `rad`, `m`, `m, rad` where they differ, or the meaning of 0 and 1, such as
    `0 closed, 1 open`. An empty unit is unknown and is not compared."""
    meaning: Meaning = "absolute"
    """Meaning of an action: a place to go to, or a distance."""


@dataclass(frozen=True)
class Metadata(Record):
    """The needs and the answers of a policy."""

    name: Name
    """Name of the policy."""
    action: tuple[PartSpec, ...]
    """Parts of an action, in the order of a chunk's columns."""
    images: tuple[ImageSpec, ...] = ()
    """Images that the policy needs."""
    state: tuple[PartSpec, ...] = ()
    """Parts of the state that the policy needs."""
    needs_instruction: bool = False
    """True if the policy needs an instruction in words."""
    needs_goal: bool = False
    """True if the policy needs images of the goal, in `Observation.goals`."""
    horizon: Count = 1
    """Rows of a chunk."""
    rate: Hertz = 0.0
    """Rows per second [Hz]; 0 where one row is one step of the calling loop."""
    checkpoint: str = ""
    """Folder or address of the weights, without secrets."""
    checkpoint_hash: str = ""
    """SHA-256 of the weights' bytes, and of settings that are not beside them."""
    data_hash: str = ""
    """Hash of the data that it was trained on, where its settings name it."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            InvalidInput: One is wrong.
        """
        super().__post_init__()
        for what in ("images", "state", "action"):
            names = [part.name for part in getattr(self, what)]
            if len(set(names)) < len(names):
                raise InvalidInput(f"{what} names something twice: {', '.join(names)}.")

    @property
    def size(self) -> int:
        """Columns of a chunk."""
        return sum(part.size for part in self.action)


@dataclass(frozen=True, kw_only=True)
class Offer(Record):
    """The observations and actions of a robot. A policy may use less than is shown, never more."""

    action: tuple[PartSpec, ...] = ()
    """Parts of an action that the robot takes, in any order."""
    images: tuple[ImageSpec, ...] = ()
    """Images that the robot shows, with their real sizes."""
    state: tuple[PartSpec, ...] = ()
    """Parts of the state that the robot shows."""
    has_instruction: bool = True
    """True if the robot has an instruction in words."""
    has_goal: bool = True
    """True if images of the goal are sent with observations."""


def split(values: NDArray[Any], parts: Sequence[PartSpec]) -> dict[str, NDArray[Any]]:
    """Return the columns of each part by its name; the parts lie side by side along the last axis, (…, size)."""
    columns = np.split(values, np.cumsum([part.size for part in parts], dtype=int), axis=-1)
    return {part.name: own for part, own in zip(parts, columns, strict=False)}


def differences(metadata: Metadata, offer: Offer) -> list[str]:
    """Return one sentence for each reason why a policy cannot run on a robot; empty if there is none."""
    found = [
        *_differences("images", "needs", "shows", metadata.images, offer.images, ("height", "width")),
        *_differences("state", "needs", "shows", metadata.state, offer.state, ("size", "unit", "meaning")),
        *_differences("action", "gives", "takes", metadata.action, offer.action, ("size", "unit", "meaning")),
    ]
    names = {part.name for part in metadata.action}
    found += [
        f"action: the robot takes {part.name!r}, which the policy does not give"
        for part in offer.action
        if part.name not in names
    ]
    if metadata.needs_instruction and not offer.has_instruction:
        found.append("instruction: the policy needs one, and the robot has none")
    if metadata.needs_goal and not offer.has_goal:
        found.append(
            "goal: the policy needs images of the goal, and none are sent here; call it from a program that sends them "
            "in `Observation.goals`, or use a policy whose task is in words"
        )
    return found


def _differences(
    what: str, policy: str, robot: str, needed: Sequence[Any], shown: Sequence[Any], fields: Sequence[str]
) -> Iterator[str]:
    """Yield a sentence for each part that the robot lacks or has otherwise; an empty or zero field is not compared."""
    known = {part.name: part for part in shown}
    for part in needed:
        if part.name not in known:
            listed = ", ".join(map(repr, known)) or "none"
            yield f"{what}: the policy {policy} {part.name!r}; the robot {robot} {listed}"
            continue
        for name in fields:
            wanted, given = getattr(part, name), getattr(known[part.name], name)
            if wanted and given and wanted != given:
                yield (
                    f"{what}: the policy {policy} {part.name!r} with {name} {wanted!r}; the robot {robot} it with "
                    f"{given!r}"
                )
