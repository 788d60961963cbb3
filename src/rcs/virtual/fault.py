"""What a virtual robot is told to go wrong with, such as `freeze 2` or `late 60/100`."""

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
"""What every virtual robot knows, and the value of each: `freeze` has the controller hang for S seconds; after `cut`
nothing passes the cable; `late` delays what is sent by MS milliseconds; `lose` and `corrupt` are for the next N
packets; with a slash, it is one packet in N, by chance, until `clear`; `push` presses on the TCP with a force [N] along
the axes of the base, until `clear`; `reset` places the objects as a seed says;
`clear` mends all."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One thing to go wrong."""

    name: str
    """What goes wrong, such as `lose`."""
    value: str = ""
    """How much, or where, as it was told."""

    @property
    def number(self) -> float:
        """The value as a number, finite and not negative.

        Raises:
            InvalidSetup: It is none.
        """
        return self._numbers()[0]

    @property
    def force(self) -> tuple[float, float, float]:
        """Three finite numbers.

        Raises:
            InvalidSetup: They are none.
        """
        try:
            x, y, z = map(float, self.value.split())
        except ValueError:
            x = y = z = math.nan
        if not all(map(math.isfinite, (x, y, z))):
            raise InvalidSetup(f"{self.name} is told with {self.value!r}; valid is {GENERIC[self.name]}, finite.")
        return x, y, z

    @property
    def share(self) -> float:
        """One packet in how many: N of a value `X/N`, else 0 for a value without a slash.

        Raises:
            InvalidSetup: It is no number.
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
                f"{self.name} is told with {self.value!r}; valid is {GENERIC.get(self.name, 'a number')}."
            )
        return numbers

    @staticmethod
    def parse(words: Sequence[str], known: Mapping[str, str]) -> Fault:
        """Return the fault of some words, such as `["late", "60/100"]`.

        Args:
            words: Its name, and its value where it has one.
            known: The faults that are possible, and what each takes; empty for nothing.

        Raises:
            UnknownName: There is no such fault; the message has the valid ones.
            InvalidSetup: A value is missing, or there is one too many.
        """
        name, *values = words or [""]
        if name not in known:
            valid = ", ".join(f"{one} {takes}".strip() for one, takes in known.items())
            raise UnknownName("fault of this robot", name, known, f"Valid: {valid}.")
        if len(values) != len(known[name].split(" or ")[0].split()):
            raise InvalidSetup(f"The fault is {' '.join(words)!r}; valid is {f'{name} {known[name]}'.strip()!r}.")
        return Fault(name=name, value=" ".join(values))
