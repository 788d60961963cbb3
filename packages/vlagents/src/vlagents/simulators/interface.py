"""The interface of a simulator: what it shows and takes in its own names and units, its mapping, and its episodes.

The mapping between these names, images and units and those of policies is explicit, and part of a key.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from vlagents.errors import InvalidInput
from vlagents.metadata import ImageSpec, Meaning, Offer, PartSpec, split
from vlagents.observation import Observation
from vlagents.record import Count, Hertz, Name, Record

Flip = Literal["none", "rows", "columns", "both"]
"""Axes along which an image is turned over: `both` is half a turn."""
Rotation = Literal["none", "rotation_vector", "intrinsic_xyz"]
"""A simulator's form of a rotation that is roll, pitch and yaw here (extrinsic xyz)."""
Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ImageMap(Record):
    """An image as policies get it."""

    name: Name
    camera: Name
    """The simulator's camera."""
    flip: Flip = "none"


@dataclass(frozen=True, kw_only=True)
class PartMap(Record):
    """A part of the state or of an action: the simulator's numbers are `scale` times those here, plus `offset`."""

    name: Name
    of: tuple[Name, ...]
    """The simulator's parts that it is made of, side by side."""
    unit: str = ""
    """Unit of its numbers here, as in `PartSpec`."""
    meaning: Meaning = "absolute"
    scale: tuple[float, ...] = (1.0,)
    """Factor of each number, or of all."""
    offset: tuple[float, ...] = (0.0,)
    """Offset of each number, or of all, in the simulator's unit."""
    rotation: Rotation = "none"
    """The simulator's form of the last three numbers of an action."""

    def to_simulator(self, values: Array) -> Array:
        """Return the simulator's numbers."""
        if self.rotation != "none":
            values = np.concatenate([values[:-3], _rotation(values[-3:], self.rotation)])
        return np.multiply(self.scale, values) + self.offset

    def from_simulator(self, parts: Mapping[str, NDArray[Any]]) -> Array:
        """Return the numbers here for the simulator's parts; rotations are not converted back."""
        values = np.concatenate([np.asarray(parts[name], np.float64) for name in self.of])
        return (values - self.offset) / self.scale


@dataclass(frozen=True, kw_only=True)
class SimulatorMapping(Record):
    """Everything between a simulator and a policy. Two results compare only if their mappings are equal."""

    images: tuple[ImageMap, ...]
    state: tuple[PartMap, ...]
    action: tuple[PartMap, ...]
    wait: Annotated[int, Meta(ge=0, le=100_000)] = 0
    """Steps at the beginning of an episode that the policy does not see, in which objects come to rest."""
    wait_action: tuple[float, ...] = ()
    """Action of these steps, in the simulator's numbers."""
    start: Literal["drawn", "stored"] = "drawn"
    """Starts are drawn from the seed, or are the simulator's stored ones: that of number `seed` modulo their number."""
    steps: Count
    """Most steps of an episode, beside those of `wait`."""
    instruction: str
    """The task in words."""

    def check(self, facts: Facts) -> None:
        """Refuse a mapping that does not fit a simulator.

        Raises:
            InvalidInput: It does not; the message has all differences, a line each.
        """
        if found := list(self._differences(facts)):
            lines = "\n".join(f"- {line}" for line in found)
            raise InvalidInput(f"The mapping and the simulator {facts.name!r} do not fit:\n{lines}")

    def offer(self, facts: Facts) -> Offer:
        """Return what a policy is shown and may command."""
        sizes = {image.name: image for image in facts.images}
        shown, taken = _sizes(facts.state), _sizes(facts.action)
        return Offer(
            images=tuple(ImageSpec(i.name, sizes[i.camera].height, sizes[i.camera].width) for i in self.images),
            state=tuple(PartSpec(p.name, sum(shown[name] for name in p.of), p.unit) for p in self.state),
            action=tuple(PartSpec(p.name, sum(taken[n] for n in p.of), p.unit, p.meaning) for p in self.action),
            has_instruction=bool(self.instruction),
            has_goal=False,
        )

    def bounds(self, facts: Facts) -> tuple[Array, Array]:
        """Return the least and the largest numbers of an action here, (size,) each."""
        theirs = [split(np.array(raw), facts.action) for raw in (facts.low, facts.high)]
        ends = [np.concatenate([part.from_simulator(own) for part in self.action]) for own in theirs]
        return np.minimum(*ends), np.maximum(*ends)

    def observation(self, seen: Observation) -> Observation:
        """Return a simulator's observation as a policy gets it."""
        state = {part.name: part.from_simulator(seen.state) for part in self.state}
        images = {image.name: _flipped(seen.image(image.camera), image.flip) for image in self.images}
        return Observation(images, state, self.instruction, time=seen.time)

    def action_of(self, values: Array, facts: Facts) -> Array:
        """Return the simulator's action for a policy's, within the simulator's bounds.

        Raises:
            InvalidInput: It has another size, or a number that is not finite.
        """
        theirs = {part.name: part for part in facts.action}
        size = sum(part.size for part in facts.action)
        if values.shape != (size,) or not np.isfinite(values).all():
            raise InvalidInput(f"The action is {values}; valid are {size} finite numbers.")
        raw: dict[str, Array] = {}
        for part in self.action:
            of = [theirs[name] for name in part.of]
            own, values = np.split(values, [sum(one.size for one in of)])
            raw |= split(part.to_simulator(own), of)
        return np.clip(np.concatenate([raw[name] for name in theirs]), facts.low, facts.high)

    def _differences(self, facts: Facts) -> Iterator[str]:
        for what, named in (("images", self.images), ("state", self.state), ("action", self.action)):
            names = [one.name for one in named]
            yield from (f"{what}: {name!r} is there twice" for name in dict.fromkeys(names) if names.count(name) > 1)
        cameras = [image.name for image in facts.images]
        for image in self.images:
            if image.camera not in cameras:
                yield f"images: {image.name!r} is of the camera {image.camera!r}; there are {_listed(cameras)}"
        for what, parts, own in (("state", self.state, facts.state), ("action", self.action, facts.action)):
            sizes = _sizes(own)
            for part in parts:
                if not part.of:
                    yield f"{what}: {part.name!r} is of nothing; there are {_listed(list(sizes))}"
                    continue
                if unknown := [name for name in part.of if name not in sizes]:
                    yield f"{what}: {part.name!r} is of {_listed(unknown)}; there are {_listed(list(sizes))}"
                    continue
                size = sum(sizes[name] for name in part.of)
                for name in ("scale", "offset"):
                    if (count := len(getattr(part, name))) not in (1, size):
                        yield f"{what}: {name} of {part.name!r} has {count} numbers; valid are 1 or {size}"
                if not all(np.isfinite([*part.scale, *part.offset])) or 0.0 in part.scale:
                    yield f"{what}: scale of {part.name!r} is {part.scale}; valid are finite numbers other than 0"
                if part.rotation != "none" and (what == "state" or size < 3):
                    yield f"{what}: {part.name!r} has no rotation to convert to {part.rotation!r}"
        used, wanted = [name for part in self.action for name in part.of], [part.name for part in facts.action]
        if sorted(used) != sorted(wanted):
            yield f"action: it sets {_listed(used)}; valid is to set each of {_listed(wanted)} once"
        size = sum(part.size for part in facts.action)
        if self.wait and len(self.wait_action) != size:
            yield f"wait_action: it has {len(self.wait_action)} numbers; an action has {size}"
        if self.start == "stored" and not facts.starts:
            yield "start: the simulator has no stored starts; valid is 'drawn'"
        if self.wait + self.steps > facts.steps:
            yield f"steps: {self.wait} + {self.steps} are more than the simulator's {facts.steps}"


@dataclass(frozen=True, kw_only=True)
class Facts(Record):
    """Everything that a simulator says about itself, in its own names and units."""

    name: Name
    """Simulator and task, such as `metaworld:pick-place-v3`."""
    versions: Mapping[str, str]
    """Version of each package that decides what happens."""
    images: tuple[ImageSpec, ...]
    """Its cameras, with the size of their images."""
    state: tuple[PartSpec, ...]
    """Numbers that it shows."""
    action: tuple[PartSpec, ...]
    """Parts of an action, in the order of its numbers."""
    low: tuple[float, ...]
    """Smallest numbers of an action."""
    high: tuple[float, ...]
    """Largest numbers of an action."""
    rate: Hertz
    """Steps per second of simulated time [Hz]."""
    steps: Count
    """Most steps of an episode."""
    starts: int = 0
    """Number of stored starts; 0 if it has none."""
    mapping: SimulatorMapping
    """The mapping that is used if none is given."""


@dataclass(frozen=True)
class Moment:
    """A simulator after the reset, or after a step."""

    observation: Observation
    reward: float = 0.0
    success: bool | None = None
    """Whether the task is done; None if the simulator does not know."""
    is_over: bool = False
    """Whether the simulator ends the episode here."""

    def __post_init__(self) -> None:
        """Check the reward; the observation has checked its numbers.

        Raises:
            InvalidInput: It is not finite.
        """
        if not math.isfinite(self.reward):
            raise InvalidInput(f"The reward is {self.reward!r}; valid is a finite number.")


class Simulator(ABC):
    """One task of a simulator. All calls come from one thread."""

    facts: Facts

    @abstractmethod
    def reset(self, seed: int, start: int | None) -> Moment:
        """Begin an episode; the same arguments begin the same one.

        Args:
            seed: Seed of everything that is drawn.
            start: Number of the stored start; None to draw one.
        """

    @abstractmethod
    def step(self, action: NDArray[np.float64]) -> Moment:
        """Make a step with an action in the simulator's own numbers."""

    def close(self) -> None:  # noqa: B027  a simulator may hold nothing
        """Release everything. A second call does nothing."""


def _sizes(parts: Sequence[PartSpec]) -> dict[str, int]:
    return {part.name: part.size for part in parts}


def _listed(names: Sequence[str]) -> str:
    return ", ".join(map(repr, names)) or "none"


def _flipped(image: NDArray[np.uint8], flip: Flip) -> NDArray[np.uint8]:
    axes = {"none": (), "rows": (0,), "columns": (1,), "both": (0, 1)}[flip]
    return np.ascontiguousarray(np.flip(image, axes))


def _rotation(rpy: Array, form: Rotation) -> Array:
    """Return roll, pitch, yaw (extrinsic xyz, R = Rz·Ry·Rx) as a rotation vector, or as angles of R = Rx·Ry·Rz."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(rpy), np.sin(rpy)
    r = np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )
    if form == "intrinsic_xyz":
        return np.array(
            [np.arctan2(-r[1, 2], r[2, 2]), np.arcsin(np.clip(r[0, 2], -1, 1)), np.arctan2(-r[0, 1], r[0, 0])]
        )
    twice_sine = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    sine = float(np.linalg.norm(twice_sine)) / 2
    angle = float(np.arctan2(sine, (np.trace(r) - 1) / 2))
    return twice_sine / 2 * (angle / sine if sine > 1e-9 else 1.0)  # half a turn is no motion of one step
