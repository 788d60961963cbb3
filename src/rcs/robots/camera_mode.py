"""The formats in which a camera streams: sizes, and the frame rates of each."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rcs_data.record import Record, Whole

from rcs.errors import InvalidSetup, UnknownName


class ResolutionMode(Record, kw_only=False):
    """One colour format of a camera."""

    width: Whole
    """Pixels."""
    height: Whole
    """Pixels."""
    rates: tuple[Whole, ...]
    """Frame rates to choose from, ascending [frames/s]."""

    def __post_init__(self) -> None:
        """Check the figures.

        Raises:
            InvalidSetup: A size or rate is not positive, there is no rate, or rates do not ascend.
        """
        super().__post_init__()
        if not self.rates or any(a >= b for a, b in zip(self.rates, self.rates[1:], strict=False)):
            raise InvalidSetup(f"rates is {self.rates}; valid are ascending rates, at least one.")

    @property
    def name(self) -> str:
        """Its name, such as `848x480`."""
        return f"{self.width}x{self.height}"

    def __str__(self) -> str:
        """Return size and rates in words."""
        return f"{self.name} at {', '.join(map(str, self.rates))} Hz"


def parse_mode(name: str) -> tuple[int, int] | None:
    """Return width and height [px] of a mode's name; None if it is not of the form `848x480`."""
    width, _, height = name.partition("x")
    if not (name.isascii() and width.isdecimal() and height.isdecimal()):
        return None
    return int(width), int(height)


def find_mode(label: str, modes: Sequence[ResolutionMode], name: str) -> ResolutionMode:
    """Return the mode with a name.

    Args:
        label: The camera's name, for messages.
        modes: Modes of the camera.
        name: Name of a mode, such as `848x480`.

    Raises:
        UnknownName: The camera has no such mode; the message lists all.
    """
    for mode in modes:
        if mode.name == name:
            return mode
    raise UnknownName(f"mode of {label}", name, [mode.name for mode in modes])


def choose_rate(label: str, modes: Sequence[ResolutionMode], size: tuple[int, int], wanted: float | None) -> int:
    """Return the rate at which a camera delivers frames of a size [frames/s].

    A size that is not a mode is cropped and scaled from a larger one, so it may have the rate of any larger mode; a
    size larger than all modes has the rates of the largest.

    Args:
        label: The camera's name, for messages.
        modes: Modes of the camera.
        size: Width and height of frames [px].
        wanted: The wanted rate [frames/s]; None for the highest.

    Raises:
        InvalidSetup: The camera does not offer that rate for that size; the message lists all modes.
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
