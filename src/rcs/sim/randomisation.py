"""The ranges of domain randomisation, as one frozen record."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rcs.errors import InvalidSetup

Factors = tuple[float, float]
"""Lowest and highest factor on the nominal value; (1, 1) changes nothing."""

_SAME: Factors = (1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Randomisation:
    """Ranges from which every episode draws uniformly. A range without width changes nothing, not even a bit.

    Each field draws from its own stream, so switching one on or off does not change others.
    """

    light_intensity: Factors = (0.5, 1.5)
    """Factor on the brightness of each light."""
    light_direction: float = 0.3
    """Largest turn of each light about each axis [rad]."""
    light_position: float = 0.2
    """Largest shift of each light along each axis [m]; directional lights do not change."""
    table_colour: float = 0.15
    """Largest change of red, green and blue of the table, of 1."""
    object_colour: float = 0.10
    """The same for each object of the task."""
    room_colour: float = 0.15
    """The same for each wall and the floor."""
    textures: int = 4
    """Number of procedural textures of the table top besides its own look, all equally likely."""
    camera_translation: float = 0.01
    """Largest shift of each camera along each axis of its optical frame [m]."""
    camera_rotation: float = 0.03
    """Largest turn of each camera about each axis of its optical frame [rad]."""
    field_of_view: Factors = (0.97, 1.03)
    """Factor on the vertical field of view of each camera."""
    object_size: Factors = (0.9, 1.1)
    """Factor on the size of each object of simple or soft shapes; mass and material stay the same."""
    object_mass: Factors = (0.5, 2.0)
    """Factor on the mass and the inertia of each object."""
    friction: Factors = (0.8, 1.25)
    """One factor on all friction, since a contact uses the greater of two."""
    joint_damping: Factors = (0.8, 1.25)
    """Factor on the damping of each joint of the robots, fingers included."""

    def __post_init__(self) -> None:
        """Check every range.

        Raises:
            InvalidSetup: A range is not valid, or would make something negative.
        """
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name == "textures":
                if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= MAX_TEXTURES:
                    raise InvalidSetup(
                        f"randomisation: textures is {value!r}; valid is a whole number from 0 to {MAX_TEXTURES}."
                    )
            elif field.name in FACTORS:
                object.__setattr__(self, field.name, _factors(field.name, value))
            elif not _is_number(value) or value < 0 or value > LIMITS.get(field.name, math.inf):
                most = f" to {LIMITS[field.name]:g}" if field.name in LIMITS else " and more"
                raise InvalidSetup(f"randomisation: {field.name} is {value!r}; valid is 0{most}.")

    @staticmethod
    def off(**ranges: Any) -> Randomisation:
        """Return ranges without width, except those given."""
        nothing: dict[str, Any] = {
            field.name: _SAME if field.name in FACTORS else 0 if field.name == "textures" else 0.0
            for field in dataclasses.fields(Randomisation)
        }
        return Randomisation(**{**nothing, **ranges})

    def varies(self, field: str) -> bool:
        """Return whether a field's range has a width."""
        value: float | Factors = getattr(self, field)
        return value != _SAME if isinstance(value, tuple) else value > 0

    def bounds(self, field: str) -> tuple[float, float]:
        """Return the bounds of a field's uniform draw; for textures, of a number to be rounded down."""
        value: float | Factors = getattr(self, field)
        if isinstance(value, tuple):
            return value
        return (0.0, value + 1.0) if field == "textures" else (-float(value), float(value))

    def to_json(self) -> dict[str, Any]:
        """Return the ranges as JSON values."""
        values = dataclasses.asdict(self)
        return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}

    @staticmethod
    def from_json(values: dict[str, Any]) -> Randomisation:
        """Return the ranges that `to_json` wrote; missing fields have their defaults.

        Raises:
            InvalidSetup: A key is unknown or a value is not valid.
        """
        known = {field.name for field in dataclasses.fields(Randomisation)}
        if unknown := sorted(set(values) - known):
            raise InvalidSetup(f"A randomisation has no fields {unknown}; it has {sorted(known)}.")
        return Randomisation(**values)


FACTORS = frozenset(
    {"light_intensity", "field_of_view", "object_size", "object_mass", "friction", "joint_damping"},
)
"""Fields that are factors."""
LIMITS = {
    "light_direction": 1.0,
    "table_colour": 1.0,
    "object_colour": 1.0,
    "room_colour": 1.0,
    "camera_translation": 0.5,
    "camera_rotation": 1.0,
}
"""Largest values of the others, if limited: beyond these, cameras look elsewhere and lights shine from below."""
MAX_TEXTURES = 16
"""Each takes 48 kB in the model."""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _factors(name: str, value: Any) -> Factors:
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 2:
        raise InvalidSetup(f"randomisation: {name} is {value!r}; valid are the lowest and the highest factor.")
    low, high = value
    if not (_is_number(low) and _is_number(high) and 0 < low <= high):
        raise InvalidSetup(f"randomisation: {name} is {value!r}; valid are two factors above 0, the lower one first.")
    return float(low), float(high)
