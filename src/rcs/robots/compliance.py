"""How an arm gives way to a push: as springs and dampers, at its joints or at its TCP."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from rcs_data.options import NotNegative, Positive, Record, converted

from rcs.errors import InvalidSetup
from rcs.robots.description import ArmDescription


def _numbers(given: float | Sequence[float] | None) -> tuple[float, ...] | None:
    given = given.tolist() if isinstance(given, np.ndarray) else given
    return given if given is None or isinstance(given, Sequence) else (given,)  # pyright: ignore[reportReturnType]


class Compliance(Record):
    """Springs and dampers between where an arm is led and where it is: a push moves it by force over stiffness.

    Weight and friction are compensated. Either `joints` or `tcp` is given.
    """

    joints: tuple[Positive, ...] | None = converted(converter=_numbers, default=None)
    """Stiffness of the joints [N·m/rad]: one number for all, or one for each."""
    tcp: tuple[Positive, ...] | None = converted(converter=_numbers, default=None)
    """Stiffness of the TCP along and about the axes of the base: one number for x, y, z [N/m] and one about them
    [N·m/rad], or six. An arm with more than six joints keeps its elbow by a soft spring that the TCP does not feel."""
    damping: tuple[NotNegative, ...] | None = converted(converter=_numbers, default=None)
    """As many numbers, [N·m·s/rad] or [N·s/m]; None for the critical one of the arm at home."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidSetup: Both of `joints` and `tcp` or neither are given, a number is invalid, or their count.
        """
        super().__post_init__()
        if (self.joints is None) == (self.tcp is None):
            given = "both" if self.tcp is not None else "neither"
            raise InvalidSetup(f"Either joints or tcp must be given, got {given}.")
        for name in ("joints", "tcp", "damping"):
            values: tuple[float, ...] | None = getattr(self, name)
            if values is None:
                continue
            if not values:
                raise InvalidSetup(f"{name} is (); valid are finite numbers.")
            if self.is_of_tcp:
                if len(values) not in (2, 6):
                    raise InvalidSetup(
                        f"{name} has {len(values)} numbers; those of the TCP are two, for x, y, z and about them, or "
                        "six."
                    )
                values = values if len(values) == 6 else (values[0],) * 3 + (values[1],) * 3
                object.__setattr__(self, name, values)

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


def _each(name: str, values: Any, arm: ArmDescription) -> Any:
    if values is None or len(values) == arm.dof:
        return values
    if len(values) != 1:
        raise InvalidSetup(
            f"{name} has {len(values)} numbers; valid for {arm.label} is one, or {arm.dof}, one for each joint."
        )
    return values * arm.dof
