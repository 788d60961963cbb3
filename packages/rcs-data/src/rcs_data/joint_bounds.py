"""What the joints of an arm can do, stored with the column that has their positions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from rcs_data.errors import InvalidSetup
from rcs_data.text import check_text


@dataclass(frozen=True, kw_only=True)
class JointBounds:
    """Ranges and speeds of an arm's joints, with which its recorded positions are checked.

    Raises:
        InvalidSetup: The numbers are not finite, or not one per joint.
    """

    arm: str
    """The arm in words, such as "Franka Research 3"."""
    names: tuple[str, ...]
    """The joints, in the order of the column."""
    lower: tuple[float, ...]
    """Lower ends of their ranges [rad]."""
    upper: tuple[float, ...]
    """Upper ends of their ranges [rad]."""
    velocity: tuple[float, ...]
    """Largest speeds [rad/s]."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_text(self.arm, "The arm of joint limits")
        object.__setattr__(self, "names", tuple(self.names))
        for name in self.names:
            check_text(name, "The name of a joint")
        for field in ("lower", "upper", "velocity"):
            object.__setattr__(self, field, _numbers(field, getattr(self, field), len(self.names)))

    def to_json(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: object) -> JointBounds:
        """Build the limits from what `to_json` returned.

        Raises:
            InvalidSetup: A field is missing, unknown or does not make sense.
        """
        if not isinstance(values, Mapping) or set(values) != {field.name for field in fields(cls)}:
            raise InvalidSetup(f"Not a description of joint limits: {values!r:.200}.")
        names: Any = values["names"]
        if not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
            raise InvalidSetup(f"Names of joints are {names!r:.80}; they must be texts.")
        return cls(**values)


def _numbers(field: str, given: Any, count: int) -> tuple[float, ...]:
    is_list = isinstance(given, Sequence) and not isinstance(given, str)
    numbers = list(given) if is_list else []
    is_right = all(isinstance(n, int | float) and not isinstance(n, bool) and math.isfinite(n) for n in numbers)
    if not is_list or not is_right or len(numbers) != count:
        raise InvalidSetup(
            f"Joint limits have {field} {given!r:.80}; it must be {count} finite numbers, one per joint."
        )
    return tuple(float(number) for number in numbers)
