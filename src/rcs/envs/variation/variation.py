"""Fields of a randomisation that are enabled for a world: what is drawn at the start of episodes, and who writes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.envs.episode_random import EpisodeRandom
from rcs.sim.randomisation import Randomisation
from rcs.sim.world import Copies, World

Values = NDArray[np.float64]
Write = Callable[[dict[str, Values], Copies], None]
"""Writes what was drawn, by field, for some copies; None for all."""
Finish = Callable[[Values], Values]
"""Makes a field's values, (*leading, ...), from its uniform draws."""


class Variation:
    """Draws the enabled fields of one world, each from a stream of its own, and has them written."""

    memory = ("values",)

    def __init__(self, world: World, ranges: Randomisation) -> None:
        """Enable nothing yet; the world is fresh from its model."""
        self.world = world
        self.ranges = ranges
        self.changes_constants = False
        """Whether constants that MuJoCo derives, such as from masses, are to be computed after writing."""
        self.names: dict[str, tuple[str, ...]] = {}
        """What the rows of each field's values belong to, in order."""
        self.values: dict[str, Values] = {}
        """The draws of the present episodes, by field of `Randomisation`: (*leading, ...), replaced as a whole."""
        self._bounds: dict[str, tuple[Values, Values]] = {}
        self._finishes: dict[str, Finish] = {}
        self._writes: list[Write] = []
        self._begins: list[Callable[[EpisodeRandom, Copies], None]] = []

    def enable(
        self,
        field: str,
        shape: tuple[int, ...],
        names: Sequence[str] = (),
        *,
        draws: tuple[ArrayLike, ArrayLike] | None = None,
        finish: Finish | None = None,
    ) -> bool:
        """Enable a field if its range has a width and there is something to vary; return whether.

        Args:
            field: Of `Randomisation`.
            shape: Shape of its values for one copy.
            names: What the rows of its values belong to.
            draws: Bounds of the uniform draws, if not those of the field's range in the shape of its values.
            finish: Makes the values from the draws; None if they are the values.
        """
        if not self.ranges.varies(field) or 0 in shape:
            return False
        low, high = self.ranges.bounds(field) if draws is None else draws
        drawn = shape if draws is None else np.broadcast_shapes(np.shape(low), np.shape(high))
        self._bounds[field] = np.full(drawn, low), np.full(drawn, high)
        if finish is not None:
            self._finishes[field] = finish
        self.names[field] = tuple(names)
        self.values[field] = np.zeros(self.world.leading + shape)
        return True

    def write_with(self, write: Write) -> None:
        """Have what is drawn written by a function."""
        self._writes.append(write)

    def begin_too(self, begin: Callable[[EpisodeRandom, Copies], None]) -> None:
        """Have something else started with the streams of each episode; it takes a branch of them."""
        self._begins.append(begin)

    def begin(self, draws: EpisodeRandom, copies: Copies = None) -> None:
        """Draw and write the values of some copies' next episodes.

        Args:
            draws: Random numbers for exactly these copies; they are not advanced.
            copies: Which copies; None for all.
        """
        streams = draws.branch("randomisation")
        for begin in self._begins:
            begin(streams, copies)
        if not self._bounds:
            return
        drawn: dict[str, Values] = {}
        for field, (low, high) in self._bounds.items():
            uniform = streams.branch(field).uniform(low, high)
            finish = self._finishes.get(field)
            drawn[field] = uniform if finish is None else finish(uniform)
        for write in self._writes:
            write(drawn, copies)
        if self.changes_constants:
            self.world.update_constants(copies)
        if copies is None:
            self.values = drawn
        else:
            self.values = {field: values.copy() for field, values in self.values.items()}
            for field, values in drawn.items():
                self.values[field][copies] = values
