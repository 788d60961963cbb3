"""What a policy needs and gives, what a robot offers and expects, and how the two differ."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal

from vlagents.errors import InvalidInput

Meaning = Literal["absolute", "relative", "delta"]
"""Whether an action says where to go, how far from where the chunk began, or how far from the action before."""
MEANINGS = ("absolute", "relative", "delta")


@dataclass(frozen=True)
class ImageSpec:
    """A camera's picture."""

    name: str
    """Name of the camera, as in `Observation.images`."""
    height: int = 0
    """Pixels; 0 for any."""
    width: int = 0
    """Pixels; 0 for any."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            InvalidInput: One is wrong.
        """
        _check_name("image", self.name)
        for name in ("height", "width"):
            _check_whole(f"{name} of image {self.name!r}", getattr(self, name), 0)


@dataclass(frozen=True)
class PartSpec:
    """A part of the robot's state, or of an action."""

    name: str
    """Its name: `joints`, `tquat`, `xyzrpy`, `gripper`, `hand`, or another."""
    size: int
    """How many numbers it has."""
    unit: str = ""
    """Of its numbers: `rad`, `m`, `m, rad` where they differ, or what 0 and 1 are, such as `0 closed, 1 open`. Empty
    where it is not known; then it is not compared."""
    meaning: Meaning = "absolute"
    """Of an action: where to go, or how far."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            InvalidInput: One is wrong.
        """
        _check_name("part", self.name)
        _check_whole(f"size of part {self.name!r}", self.size, 1)
        if self.meaning not in MEANINGS:
            raise InvalidInput(f"meaning of {self.name!r} is {self.meaning!r}; valid: {', '.join(MEANINGS)}.")


@dataclass(frozen=True)
class Metadata:
    """What a policy needs, and what it gives."""

    name: str
    """Name of the policy."""
    action: tuple[PartSpec, ...]
    """Parts of an action, in the order of a chunk's columns."""
    images: tuple[ImageSpec, ...] = ()
    """Pictures that it needs."""
    state: tuple[PartSpec, ...] = ()
    """Parts of the state that it needs."""
    needs_instruction: bool = False
    """Whether it must be told in words what to do."""
    horizon: int = 1
    """Rows of a chunk."""
    rate: float = 0.0
    """Rows per second [Hz]; 0 where one row is one step of whatever loop asks."""
    continues: bool = False
    """Whether its chunks can go on from an observation's `previous` rows, so that nobody need blend the two."""
    checkpoint: str = ""
    """Which weights: a folder or an address, without what is secret in it."""
    checkpoint_hash: str = ""
    """SHA-256 of the weights' bytes."""
    version: str = ""
    """Of the code that runs it."""
    extra: Mapping[str, Any] = field(default_factory=dict)
    """What a server of another kind told besides, as it came."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            InvalidInput: One is wrong.
        """
        _check_name("policy", self.name)
        _check_whole("horizon", self.horizon, 1)
        if not (isinstance(self.rate, (int, float)) and math.isfinite(self.rate) and self.rate >= 0):
            raise InvalidInput(f"rate is {self.rate!r}; valid is a number of hertz, or 0.")
        if not isinstance(self.continues, bool):
            raise InvalidInput(f"continues is {self.continues!r}; valid: True, False.")
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
        return {**asdict(self), "extra": dict(self.extra)}

    @classmethod
    def from_dict(cls, given: object) -> Metadata:
        """Read what `to_dict` made.

        Raises:
            InvalidInput: Something is missing or wrong.
        """
        return _read(cls, given)


@dataclass(frozen=True)
class Offer:
    """What a robot shows and expects. A policy may use less of what is shown, never more."""

    action: tuple[PartSpec, ...] = ()
    """Parts of an action that the robot takes, in any order."""
    images: tuple[ImageSpec, ...] = ()
    """Pictures that it shows, with their real sizes."""
    state: tuple[PartSpec, ...] = ()
    """Parts of the state that it shows."""
    has_instruction: bool = True
    """Whether it says in words what to do."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, as JSON and msgpack take them."""
        return asdict(self)

    @classmethod
    def from_dict(cls, given: object) -> Offer:
        """Read what `to_dict` made.

        Raises:
            InvalidInput: Something is missing or wrong.
        """
        return _read(cls, given)


def differences(metadata: Metadata, offer: Offer) -> list[str]:
    """Return what keeps a policy from running on a robot, a sentence each; empty if nothing does."""
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


def _check_name(what: str, name: object) -> None:
    if not isinstance(name, str) or not name or len(name) > 200:
        raise InvalidInput(f"The name of a {what} is {name!r}; valid is a str of 1 to 200 characters.")


def _check_whole(what: str, value: object, least: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= 1_000_000:
        raise InvalidInput(f"{what} is {value!r}; valid is a whole number from {least} to 1000000.")


def _known(cls: type, given: object) -> dict[str, Any]:
    """Return the entries of a dictionary that a class has fields for; others are of a newer version."""
    if not isinstance(given, Mapping):
        raise InvalidInput(f"{cls.__name__} is {type(given).__name__}; valid is a dictionary.")
    names = {item.name for item in fields(cls)}
    return {name: value for name, value in given.items() if name in names}


def _list(values: Mapping[str, Any], name: str) -> Sequence[Any]:
    found = values.get(name, ())
    if not isinstance(found, (list, tuple)):
        raise InvalidInput(f"{name} is {type(found).__name__}; valid is a list.")
    return found


def _read(cls: type, given: object) -> Any:
    """Return a record of images and parts that was made plain."""
    values = _known(cls, given)
    values["images"] = tuple(_made(ImageSpec, _known(ImageSpec, image)) for image in _list(values, "images"))
    for what in ("state", "action"):
        values[what] = tuple(_made(PartSpec, _known(PartSpec, part)) for part in _list(values, what))
    return _made(cls, values)


def _made(cls: type, values: dict[str, Any]) -> Any:
    try:
        return cls(**values)
    except TypeError as error:
        raise InvalidInput(f"{cls.__name__}: {error}") from error
