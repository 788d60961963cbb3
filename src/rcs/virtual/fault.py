"""Faults of virtual robots, such as `freeze 2` or `late 60/100`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rcs.errors import InvalidSetup, UnknownName

GENERIC: Mapping[str, str] = {
    "freeze": "S",
    "cut": "",
    "late": "MS or MS/N",
    "lose": "N or 1/N",
    "corrupt": "N or 1/N",
    "push": "FX FY FZ",
    "reset": "SEED",
    "clear": "",
}
"""Faults of every virtual robot, with their values: `freeze` makes the controller hang for S seconds; `cut` cuts the
cable; `late` delays sent packets by MS milliseconds; `lose` and `corrupt` affect the next N packets; with a slash, a
fault affects one packet in N, at random, until `clear`; `push` applies a force [N] at the TCP along the axes of the
base until `clear`; `reset` places the objects according to a seed; `clear` ends all faults."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault with its value."""

    name: str
    """Name of the fault, such as `lose`."""
    value: str = ""
    """Amount or place, as given."""

    @property
    def number(self) -> float:
        """The value as a finite, non-negative number.

        Raises:
            InvalidSetup: The value is not such a number.
        """
        return self._numbers()[0]

    def whole(self, most: int) -> int:
        """Return the value as a whole number from 0 to `most`.

        Raises:
            InvalidSetup: The value is not such a number.
        """
        if not (self.value.isdecimal() and int(self.value) <= most):
            raise InvalidSetup(f"The value of {self.name} is {self.value!r}; valid is a whole number from 0 to {most}.")
        return int(self.value)

    @property
    def force(self) -> tuple[float, float, float]:
        """The value as a force: three finite numbers.

        Raises:
            InvalidSetup: The value is not three finite numbers.
        """
        try:
            x, y, z = map(float, self.value.split())
        except ValueError:
            x = y = z = math.nan
        if not all(map(math.isfinite, (x, y, z))):
            raise InvalidSetup(
                f"The value of {self.name} is {self.value!r}; valid is {GENERIC[self.name]}, three finite numbers."
            )
        return x, y, z

    @property
    def share(self) -> float:
        """N of a value `X/N`, which affects one packet in N; 0 for a value without a slash.

        Raises:
            InvalidSetup: N is not a number of at least 1.
        """
        return self._numbers()[1]

    def _numbers(self) -> tuple[float, float]:
        first, slash, second = self.value.partition("/")
        try:
            numbers = float(first), float(second) if slash else 0.0
        except ValueError:
            numbers = (math.nan, math.nan)
        if not all(math.isfinite(one) and one >= 0 for one in numbers) or (slash and numbers[1] < 1):
            raise InvalidSetup(
                f"The value of {self.name} is {self.value!r}; valid is {GENERIC.get(self.name, 'a number')}."
            )
        return numbers

    @staticmethod
    def parse(words: Sequence[str], known: Mapping[str, str]) -> Fault:
        """Return a fault from words such as `["late", "60/100"]`.

        Args:
            words: Name of the fault and its value, if it takes one.
            known: The possible faults with a description of their values; empty for faults without a value.

        Raises:
            UnknownName: There is no such fault; the message lists the valid ones.
            InvalidSetup: There are too few or too many values.
        """
        name, *values = words or [""]
        if name not in known:
            valid = ", ".join(f"{one} {takes}".strip() for one, takes in known.items())
            raise UnknownName("fault of this robot", name, known, f"Valid: {valid}.")
        if len(values) != len(known[name].split(" or ")[0].split()):
            raise InvalidSetup(f"The fault is {' '.join(words)!r}; valid is {f'{name} {known[name]}'.strip()!r}.")
        return Fault(name=name, value=" ".join(values))
