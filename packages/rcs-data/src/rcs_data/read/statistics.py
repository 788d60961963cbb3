"""Statistics of vectors for normalisation, computed in one pass with constant memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs_data.errors import InvalidSetup

Normalisation = Literal["mean_std", "min_max", "quantiles"]

# Most bins per column; beyond that many different numbers, neighbours share a bin.
_BINS = 16384
# The finest bin is 2^-80 wide. Widths double from there, so that bins are nested.
_FINEST = -80
# Vectors that are counted at a time: each time costs a millisecond per number.
_ROWS_AT_A_TIME = 1 << 14
_ARRAYS = ("mean", "std", "min", "max", "q01", "q99")


@dataclass(frozen=True, kw_only=True)
class Statistics:
    """How the numbers of a vector are distributed; arrays have shape (size,)."""

    count: int
    """Vectors seen."""
    mean: NDArray[np.float64]
    std: NDArray[np.float64]
    """The population standard deviation (divided by the count)."""
    min: NDArray[np.float64]
    max: NDArray[np.float64]
    q01: NDArray[np.float64]
    """The 1 % quantile."""
    q99: NDArray[np.float64]
    """The 99 % quantile."""

    def normalise(
        self, values: NDArray[Any], by: Normalisation = "mean_std", *, floor: ArrayLike = 0.0
    ) -> NDArray[Any]:
        """Return normalised vectors; a constant number becomes 0.

        Args:
            values: Shape (..., size).
            by: "mean_std" to mean 0 and standard deviation 1; "min_max" from -1 to 1; "quantiles" so that 98 % lie
                from -1 to 1.
            floor: Least spread to divide by, in the unit of the numbers, one for all or shape (size,). Policies need
                one: where a tool points down all the time, components of its quaternion have a spread of 0.0004, and a
                tilt by 2 degrees that no training episode had would become an input of 40. 0.05 serves joints [rad],
                poses [m] and openings; a hundredth of their bounds serves actions.

        Raises:
            InvalidSetup: There is no such normalisation, or a floor is negative or not finite.
        """
        centre, reach = self._span(by, floor)
        return (values - centre) / reach

    def denormalise(
        self, values: NDArray[Any], by: Normalisation = "mean_std", *, floor: ArrayLike = 0.0
    ) -> NDArray[Any]:
        """Invert `normalise`, whose arguments these are.

        Raises:
            InvalidSetup: There is no such normalisation, or a floor is negative or not finite.
        """
        centre, reach = self._span(by, floor)
        return values * reach + centre

    def _span(self, by: Normalisation, floor: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        least = np.asarray(floor, np.float64)
        if least.shape not in ((), self.mean.shape) or not (np.isfinite(least) & (least >= 0)).all():
            raise InvalidSetup(f"floor is {floor!r}; valid is a number from 0, or one for each of {self.mean.size}.")
        if by not in get_args(Normalisation):
            raise InvalidSetup(f"There is no normalisation {by!r}; valid are {', '.join(get_args(Normalisation))}.")
        if by == "mean_std":
            centre, reach = self.mean, self.std
        else:
            low, high = (self.min, self.max) if by == "min_max" else (self.q01, self.q99)
            centre, reach = (low + high) / 2, (high - low) / 2
        # Rounding gives a constant a tiny spread; dividing by it would amplify noise.
        is_constant = reach <= 1e-9 * np.maximum(np.abs(self.min), np.abs(self.max))
        return centre, np.where(is_constant, np.where(least > 0, least, 1.0), np.maximum(reach, least))

    def to_json(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        return {"count": self.count, **{name: getattr(self, name).tolist() for name in _ARRAYS}}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Statistics:
        """Build statistics from what `to_json` returned.

        Raises:
            InvalidSetup: A field is missing or not numeric.
        """
        try:
            arrays = {name: np.array(values[name], np.float64) for name in _ARRAYS}
            return cls(count=int(values["count"]), **arrays)
        except (KeyError, TypeError, ValueError) as err:
            raise InvalidSetup(f"Not statistics: {values!r:.200}.") from err


class RunningStatistics:
    """Collects statistics of vectors piece by piece; how they are split affects only rounding.

    Mean and deviation: T. F. Chan, G. H. Golub, R. J. LeVeque, "Updating formulae and a pairwise algorithm for
    computing sample variances", 1979. Quantiles: numbers are counted in bins, the narrowest whose width is a power of
    two and of which at most 16384 are occupied. A quantile is off by at most one bin, 1/8000 of an evenly filled range,
    and exact up to 16384 different numbers.
    """

    def __init__(self, size: int) -> None:
        """Start empty.

        Args:
            size: Numbers per vector.
        """
        self.count = self._counted = 0
        self._waiting: list[NDArray[np.float64]] = []
        self._mean = np.zeros(size)
        self._square = np.zeros(size)
        self._low = np.full(size, np.inf)
        self._high = np.full(size, -np.inf)
        self._bins = [_Bins() for _ in range(size)]

    def add(self, values: NDArray[Any]) -> None:
        """Take the next vectors, shape (rows, size).

        Raises:
            InvalidSetup: The shape is wrong, or a number is not finite.
        """
        numbers = np.array(values, np.float64)
        if numbers.ndim != 2 or numbers.shape[1] != len(self._mean):
            raise InvalidSetup(f"Vectors have shape {numbers.shape}; expected (rows, {len(self._mean)}).")
        is_finite = np.isfinite(numbers)
        if not is_finite.all():
            row, column = np.argwhere(~is_finite)[0]
            raise InvalidSetup(f"Number {column} of vector {row} is {numbers[row, column]}; all must be finite.")
        self._waiting.append(numbers)
        self.count += len(numbers)
        if self.count - self._counted >= _ROWS_AT_A_TIME:
            self._count_waiting()

    def result(self) -> Statistics:
        """Return the statistics so far.

        Raises:
            InvalidSetup: No vectors were added.
        """
        if not self.count:
            raise InvalidSetup("There are no vectors to take statistics of.")
        q01, q99 = self.quantiles((0.01, 0.99))
        return Statistics(
            count=self.count,
            mean=self._mean.copy(),
            std=np.sqrt(self._square / self.count),
            min=self._low.copy(),
            max=self._high.copy(),
            q01=q01,
            q99=q99,
        )

    def quantiles(self, shares: Sequence[float]) -> NDArray[np.float64]:
        """Return quantiles of the vectors so far, of which there must be some, shape (len(shares), size).

        Args:
            shares: From 0 to 1; 0.5 for the median.
        """
        self._count_waiting()
        found = [[bins.quantile(share) for bins in self._bins] for share in shares]
        return np.clip(found, self._low, self._high)

    def _count_waiting(self) -> None:
        if self.count == self._counted:
            return
        numbers = np.concatenate(self._waiting)
        mean = numbers.mean(axis=0)
        apart, count = mean - self._mean, self.count
        self._square += ((numbers - mean) ** 2).sum(axis=0) + apart**2 * self._counted * len(numbers) / count
        self._mean += apart * len(numbers) / count
        self._low = np.minimum(self._low, numbers.min(axis=0))
        self._high = np.maximum(self._high, numbers.max(axis=0))
        for bins, column in zip(self._bins, numbers.T, strict=True):
            bins.add(column)
        self._counted = count
        self._waiting.clear()


class _Bins:
    """A histogram with bins [i * width, (i + 1) * width) of the least width that keeps them few."""

    def __init__(self) -> None:
        self._exponent = _FINEST
        self._starts = np.empty(0)  # i of each bin: whole and sorted, as floats, which are exact for any of them
        self._counts = np.empty(0, np.int64)

    def add(self, numbers: NDArray[np.float64]) -> None:
        starts = np.concatenate([self._starts, np.floor(np.ldexp(numbers, -self._exponent))])
        counts = np.concatenate([self._counts, np.ones(len(numbers), np.int64)])
        order = np.argsort(starts, kind="stable")
        starts, counts = starts[order], counts[order]
        is_first = np.append(True, starts[1:] != starts[:-1])
        while np.count_nonzero(is_first) > _BINS:
            self._exponent += 1
            starts = np.floor(starts / 2)
            is_first = np.append(True, starts[1:] != starts[:-1])
        first = np.flatnonzero(is_first)
        self._starts, self._counts = starts[first], np.add.reduceat(counts, first)

    def quantile(self, share: float) -> float:
        place = share * (self._counts.sum() - 1)
        summed = np.cumsum(self._counts)
        # Interpolated linearly, as by numpy's `quantile`.
        low, high = (
            self._starts[np.searchsorted(summed, at, side="right")] for at in (np.floor(place), np.ceil(place))
        )
        start = low + (high - low) * (place - np.floor(place))
        # The middle of the bin, or of a finest bin the number itself.
        return float(np.ldexp(start + (0.5 if self._exponent > _FINEST else 0.0), self._exponent))
