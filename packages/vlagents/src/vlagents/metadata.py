"""What a policy needs and gives, what a robot offers and expects, and how the two differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

from msgspec import Meta

from vlagents.errors import InvalidInput
from vlagents.record import Count, Hertz, Name, check, read

Meaning = Literal["absolute", "relative", "delta"]
"""An action is a target, or a motion from where the chunk began, or a motion from the action before."""
Pixels = Annotated[int, Meta(ge=0, le=1_000_000)]


@dataclass(frozen=True)
class ImageSpec:
    """A camera's image."""

    name: Name
    """Name of the camera, as in `Observation.images`."""
    height: Pixels = 0
    """Height [pixels]; 0 for any."""
    width: Pixels = 0
    """Width [pixels]; 0 for any."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            InvalidInput: One is wrong.
        """
        check(self)


@dataclass(frozen=True)
class PartSpec:
    """A part of the robot's state, or of an action."""

    name: Name
    """Its name: `joints`, `tquat`, `xyzrpy`, `gripper`, `hand`, or another."""
    size: Count
    """How many numbers it has."""
    unit: str = ""
    """Unit of its numbers: `rad`, `m`, `m, rad` where they differ, or the meaning of 0 and 1, such as
    `0 closed, 1 open`. An empty unit is unknown and is not compared."""
    meaning: Meaning = "absolute"
    """How to read an action: where to go, or how far."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            InvalidInput: One is wrong.
        """
        check(self)


@dataclass(frozen=True)
class Metadata:
    """What a policy needs, and what it gives."""

    name: Name
    """Name of the policy."""
    action: tuple[PartSpec, ...]
    """Parts of an action, in the order of a chunk's columns."""
    images: tuple[ImageSpec, ...] = ()
    """Images that the policy needs."""
    state: tuple[PartSpec, ...] = ()
    """Parts of the state that the policy needs."""
    needs_instruction: bool = False
    """Whether the policy needs an instruction in words."""
    horizon: Count = 1
    """Rows of a chunk."""
    rate: Hertz = 0.0
    """Rows per second [Hz]; 0 where one row is one step of the calling loop."""
    continues: bool = False
    """Whether chunks can continue an observation's `previous` rows, so that the two need no blending."""
    checkpoint: str = ""
    """Folder or address of the weights, without secrets."""
    checkpoint_hash: str = ""
    """SHA-256 of the weights' bytes."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            InvalidInput: One is wrong.
        """
        check(self)
        for what in ("images", "state", "action"):
            names = [part.name for part in getattr(self, what)]
            if len(set(names)) < len(names):
                raise InvalidInput(f"{what} names something twice: {', '.join(names)}.")

    @property
    def size(self) -> int:
        """Columns of a chunk."""
        return sum(part.size for part in self.action)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, as JSON and msgpack take them."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: object) -> Metadata:
        """Read what `to_dict` made.

        Raises:
            InvalidInput: Something is missing or wrong.
        """
        return read(cls, values)


@dataclass(frozen=True)
class Offer:
    """What a robot shows and expects. A policy may use less of what is shown, never more."""

    action: tuple[PartSpec, ...] = ()
    """Parts of an action that the robot takes, in any order."""
    images: tuple[ImageSpec, ...] = ()
    """Images that the robot shows, with their real sizes."""
    state: tuple[PartSpec, ...] = ()
    """Parts of the state that the robot shows."""
    has_instruction: bool = True
    """Whether the robot has an instruction in words."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, as JSON and msgpack take them."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: object) -> Offer:
        """Read what `to_dict` made.

        Raises:
            InvalidInput: Something is missing or wrong.
        """
        return read(cls, values)


def differences(metadata: Metadata, offer: Offer) -> list[str]:
    """Return one sentence for each reason why a policy cannot run on a robot; empty if there is none."""
    found = [
        *_image_differences(metadata.images, offer.images),
        *_part_differences("state", "shows", metadata.state, offer.state),
        *_part_differences("action", "takes", metadata.action, offer.action),
    ]
    names = {part.name for part in metadata.action}
    found += [
        f"action: the robot takes {part.name!r}, which the policy does not give"
        for part in offer.action
        if part.name not in names
    ]
    if metadata.needs_instruction and not offer.has_instruction:
        found.append("instruction: the policy needs one, and the robot has none")
    return found


def _image_differences(needed: Sequence[ImageSpec], shown: Sequence[ImageSpec]) -> list[str]:
    known = {image.name: image for image in shown}
    found = []
    for image in needed:
        if image.name not in known:
            found.append(f"images: the policy needs {image.name!r}; the robot shows {_listed(known)}")
            continue
        has = known[image.name]
        for name in ("height", "width"):
            wanted, given = getattr(image, name), getattr(has, name)
            if wanted and given and wanted != given:
                found.append(
                    f"images: the policy needs {image.name!r} with a {name} of {wanted} pixels; the robot shows {given}"
                )
    return found


def _part_differences(what: str, does: str, needed: Sequence[PartSpec], shown: Sequence[PartSpec]) -> list[str]:
    verb = "needs" if what == "state" else "gives"
    known = {part.name: part for part in shown}
    found = []
    for part in needed:
        if part.name not in known:
            found.append(f"{what}: the policy {verb} {part.name!r}; the robot {does} {_listed(known)}")
            continue
        has = known[part.name]
        for name in ("size", "unit", "meaning"):
            wanted, given = getattr(part, name), getattr(has, name)
            if wanted != given and wanted != "" and given != "":
                found.append(
                    f"{what}: the policy {verb} {part.name!r} with {name} {wanted!r}; the robot {does} it with "
                    f"{given!r}"
                )
    return found


def _listed(names: Mapping[str, object]) -> str:
    return ", ".join(repr(name) for name in names) or "none"
