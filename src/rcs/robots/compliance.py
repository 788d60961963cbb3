"""How an arm gives way to a push: as springs and dampers, at its joints or at its TCP."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rcs.errors import InvalidSetup, require_fields
from rcs.robots.description import ArmDescription


@dataclass(frozen=True, kw_only=True)
class Compliance:
    """Springs and dampers between where an arm is led and where it is: a push moves it by force over stiffness.

    Weight and friction are compensated. Either `joints` or `tcp` is given.
    """

    joints: float | tuple[float, ...] | None = None
    """Stiffness of the joints [N·m/rad]: one number for all, or one for each."""
    tcp: tuple[float, ...] | None = None
    """Stiffness of the TCP along and about the axes of the base: one number for x, y, z [N/m] and one about them
    [N·m/rad], or six. An arm with more than six joints keeps its elbow by a soft spring that the TCP does not feel."""
    damping: float | tuple[float, ...] | None = None
    """As many numbers, [N·m·s/rad] or [N·s/m]; None for the critical one of the arm at home."""

    def __post_init__(self) -> None:
        """Check every field, and make tuples of numbers and lists.

        Raises:
            InvalidSetup: Both of `joints` and `tcp` or neither are given, a number is not valid, or their count.
        """
        if (self.joints is None) == (self.tcp is None):
            given = "both" if self.tcp is not None else "neither"
            raise InvalidSetup(f"compliance: of joints and tcp, {given} is given; give one of the two.")
        for name in ("joints", "tcp", "damping"):
            value: Any = getattr(self, name)
            if value is None:
                continue
            value = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
            values: tuple[Any, ...] = tuple(value) if isinstance(value, list | tuple) else (value,)
            least = "from 0" if name == "damping" else "above 0"
            if not values or not all(_is_amount(one) and (one > 0 or name == "damping") for one in values):
                raise InvalidSetup(f"compliance: {name} is {value!r}; valid are finite numbers {least}.")
            if self.is_of_tcp:
                if len(values) not in (2, 6):
                    raise InvalidSetup(
                        f"compliance: {name} has {len(values)} numbers; those of the TCP are two, for x, y, z and "
                        "about them, or six."
                    )
                values = values if len(values) == 6 else (values[0],) * 3 + (values[1],) * 3
            object.__setattr__(self, name, tuple(map(float, values)))

    @property
    def is_of_tcp(self) -> bool:
        """Whether the springs are at the TCP; else they are at the joints."""
        return self.tcp is not None

    def of(self, arm: ArmDescription) -> Compliance:
        """Return this with one number for each joint of an arm, or the six of its TCP.

        Raises:
            InvalidSetup: The arm has another number of joints.
        """
        return self if self.is_of_tcp else dataclasses.replace(
            self, joints=_each("joints", self.joints, arm), damping=_each("damping", self.damping, arm)
        )  # fmt: skip

    @property
    def gains(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Stiffness and damping; no damping where none is given."""
        stiffness: Any = self.tcp or self.joints
        damping: Any = self.damping or ()
        return stiffness, damping

    def to_json(self) -> dict[str, Any]:
        """Return what is given as JSON values."""
        values = dataclasses.asdict(self)
        return {name: list(value) for name, value in values.items() if value is not None}

    @staticmethod
    def from_json(values: Mapping[str, Any]) -> Compliance:
        """Return what `to_json` wrote.

        Raises:
            InvalidSetup: A key is unknown or a value is not valid.
        """
        require_fields("field of a compliance", values, (field.name for field in dataclasses.fields(Compliance)))
        return Compliance(**values)


def _is_amount(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and value >= 0


def _each(name: str, values: Any, arm: ArmDescription) -> Any:
    if values is None or len(values) == arm.dof:
        return values
    if len(values) != 1:
        raise InvalidSetup(
            f"compliance: {name} has {len(values)} numbers; valid for {arm.label} is one, or {arm.dof}, one for each "
            "joint."
        )
    return values * arm.dof
