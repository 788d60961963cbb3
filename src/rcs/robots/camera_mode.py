"""The formats in which a camera streams: sizes, and the frame rates that each of them offers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rcs.errors import InvalidSetup, UnknownName


@dataclass(frozen=True)
class ResolutionMode:
    """One colour format of a camera."""

    width: int
    """Pixels."""
    height: int
    """Pixels."""
    rates: tuple[int, ...]
    """Frame rates to choose from, ascending [frames/s]."""

    def __post_init__(self) -> None:
        """Check the figures.

        Raises:
            InvalidSetup: A size or rate that is not positive, no rate, or rates that do not ascend.
        """
        ascends = all(a < b for a, b in zip(self.rates, self.rates[1:], strict=False))
        if min(self.width, self.height, *self.rates, 1) <= 0 or not self.rates or not ascends:
            raise InvalidSetup(f"{self} needs a positive width and height, and positive rates that ascend.")

    @property
    def name(self) -> str:
        """How it is asked for, such as `848x480`."""
        return f"{self.width}x{self.height}"

    def __str__(self) -> str:
        """Return size and rates for people."""
        return f"{self.name} at {', '.join(map(str, self.rates))} Hz"


def parse_mode(name: str) -> tuple[int, int] | None:
    """Return the width and height [px] that the name of a mode says; None for a name that is not like `848x480`."""
    width, _, height = name.partition("x")
    if not (name.isascii() and width.isdecimal() and height.isdecimal()):
        return None
    return int(width), int(height)


def find_mode(label: str, modes: Sequence[ResolutionMode], name: str) -> ResolutionMode:
    """Return the mode of a name.

    Args:
        label: The camera's name, for messages.
        modes: Those of the camera.
        name: Such as `848x480`.

    Raises:
        UnknownName: The camera has none of that name; the message has all.
    """
    for mode in modes:
        if mode.name == name:
            return mode
    raise UnknownName(f"mode of {label}", name, [mode.name for mode in modes])


def choose_rate(label: str, modes: Sequence[ResolutionMode], size: tuple[int, int], wanted: float | None) -> int:
    """Return the rate at which a camera delivers frames of a size [frames/s].

    A size that is no mode is cut out of a larger one and made smaller, so it may have the rate of any larger mode; one
    that is larger than all has those of the largest.

    Args:
        label: The camera's name, for messages.
        modes: Those of the camera.
        size: Width and height of frames [px].
        wanted: The rate that is asked for [frames/s]; None for the highest.

    Raises:
        InvalidSetup: The camera does not offer that rate for that size; the message has all modes.
    """
    fitting = [mode for mode in modes if (mode.width, mode.height) == size]
    fitting = fitting or [mode for mode in modes if mode.width >= size[0] and mode.height >= size[1]]
    fitting = fitting or [max(modes, key=lambda mode: mode.width * mode.height)]
    rates = sorted({rate for mode in fitting for rate in mode.rates})
    if wanted is None:
        return rates[-1]
    for rate in rates:
        if math.isclose(rate, wanted):
            return rate
    raise InvalidSetup(
        f"{label} does not deliver {wanted:g} frames/s of {size[0]} x {size[1]} px; it has "
        f"{', '.join(map(str, rates))} for that size. Its modes: {'; '.join(map(str, modes))}."
    )
