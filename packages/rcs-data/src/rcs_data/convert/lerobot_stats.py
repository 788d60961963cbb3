"""LeRobot's statistics per episode and dataset, for normalisation: exact, and cheap to merge.

Numbers: moments merge exactly (T. F. Chan et al., "Updating formulae and a pairwise algorithm for computing sample
variances", 1979). Images: each channel has a histogram of its 256 values, which gives everything else.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from rcs_data.content import flat_numbers

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Stats = dict[str, Any]
"""min, max, mean, std, count and quantiles of one column, as JSON values."""

# As many frames as LeRobot samples of an episode of up to 500, and about as many pixels of each.
_SAMPLED_FRAMES = 100
_SAMPLED_EDGE = 150


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Count, extremes, mean and variance of rows of numbers, all shape (size,); NaN is left out."""

    rows: int
    count: NDArray[np.int64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    mean: NDArray[np.float64]
    square: NDArray[np.float64]
    """The sum of squared distances from the mean."""

    @classmethod
    def of(cls, values: NDArray[Any]) -> Moments:
        """Return the moments of rows, shape (rows, size)."""
        numbers = values.astype(np.float64)
        valid = np.isfinite(numbers)
        count = valid.sum(axis=0)
        mean = np.where(valid, numbers, 0).sum(axis=0) / np.maximum(count, 1)
        return cls(
            rows=len(numbers),
            count=count,
            low=np.where(valid, numbers, math.inf).min(axis=0, initial=math.inf),
            high=np.where(valid, numbers, -math.inf).max(axis=0, initial=-math.inf),
            mean=mean,
            square=np.where(valid, numbers - mean, 0).__pow__(2).sum(axis=0),
        )

    def merged(self, other: Moments) -> Moments:
        """Return the moments of both together."""
        count = self.count + other.count
        share = other.count / np.maximum(count, 1)
        apart = other.mean - self.mean
        return Moments(
            rows=self.rows + other.rows,
            count=count,
            low=np.minimum(self.low, other.low),
            high=np.maximum(self.high, other.high),
            mean=self.mean + apart * share,
            square=self.square + other.square + apart**2 * self.count * share,
        )

    def stats(self, quantiles: dict[str, NDArray[np.float64]]) -> Stats | None:
        """Return the statistics; None where a number was never measured.

        Args:
            quantiles: Under each name of `QUANTILES`, shape (size,).
        """
        if not self.count.all():
            return None
        values = {
            "min": self.low,
            "max": self.high,
            "mean": self.mean,
            "std": np.sqrt(self.square / self.count),
            **quantiles,
        }
        return {**{name: value.tolist() for name, value in values.items()}, "count": [self.rows]}


def quantiles(values: NDArray[Any]) -> dict[str, NDArray[np.float64]]:
    """Return the quantiles of rows, shape (rows, size), each of shape (size,); NaN is left out."""
    numbers = values.astype(np.float64)
    if not np.isfinite(numbers).any(axis=0).all():
        return {name: np.full(numbers.shape[1], math.nan) for name in QUANTILES}
    found = np.nanquantile(numbers, list(QUANTILES.values()), axis=0)
    return dict(zip(QUANTILES, found, strict=True))


def column_quantiles(files: Sequence[Path], name: str) -> dict[str, NDArray[np.float64]]:
    """Return the quantiles of one column of many files, with only that column in memory.

    Args:
        files: Parquet files.
        name: The column.
    """
    parts: list[NDArray[Any]] = []
    for path in files:
        with pq.ParquetFile(path) as file:
            column = file.read(columns=[name]).column(name)
        parts.append(flat_numbers(column).reshape(len(column), -1))
    return quantiles(np.concatenate(parts))


class ImageHistogram:
    """A histogram of each channel's 256 values, over a sample of frames and pixels."""

    def __init__(self, frames: int = 0) -> None:
        """Start empty.

        Args:
            frames: Number of frames that will be given to `add`; 100 of them, evenly spaced, are counted.
        """
        self.sampled = 0
        self.counts = np.zeros((3, 256), np.int64)
        self._stride = max(1, math.ceil(frames / _SAMPLED_FRAMES))
        self._seen = 0

    def add(self, image: NDArray[Any]) -> None:
        """Add the next frame, (H, W, 3) uint8."""
        if self._seen % self._stride == 0:
            step = max(1, max(image.shape[:2]) // _SAMPLED_EDGE)
            sample = image[::step, ::step]
            for channel in range(3):
                self.counts[channel] += np.bincount(sample[..., channel].reshape(-1), minlength=256)
            self.sampled += 1
        self._seen += 1

    def merge(self, other: ImageHistogram) -> None:
        """Add another histogram."""
        self.counts += other.counts
        self.sampled += other.sampled

    def stats(self) -> Stats:
        """Return the statistics of values from 0 to 1, each of shape (3, 1, 1)."""
        values = np.arange(256) / 255
        total = self.counts.sum(axis=1)
        mean = self.counts @ values / total
        std = np.sqrt((self.counts * (values - mean[:, None]) ** 2).sum(axis=1) / total)
        summed = self.counts.cumsum(axis=1)
        found = {"min": self._value(summed, 0.0), "max": self._value(summed, 1.0), "mean": mean, "std": std}
        found |= {name: self._value(summed, share) for name, share in QUANTILES.items()}
        return {**{name: v.reshape(3, 1, 1).tolist() for name, v in found.items()}, "count": [self.sampled]}

    @staticmethod
    def _value(summed: NDArray[np.int64], share: float) -> NDArray[np.float64]:
        """Return a quantile of each channel, interpolated linearly as by numpy's `quantile`."""
        place = share * (summed[:, -1] - 1)
        low = [np.searchsorted(row, math.floor(p), side="right") for row, p in zip(summed, place, strict=True)]
        high = [np.searchsorted(row, math.ceil(p), side="right") for row, p in zip(summed, place, strict=True)]
        return (np.array(low) + (np.array(high) - low) * (place - np.floor(place))) / 255
