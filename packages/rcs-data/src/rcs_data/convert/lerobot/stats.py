"""LeRobot's statistics of an episode and of a dataset, for normalisation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.read.statistics import RunningStatistics

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Stats = dict[str, Any]
"""min, max, mean, std, count and quantiles of one column, as JSON values."""

# As many frames as LeRobot samples of an episode of up to 500, and about as many pixels of each.
_SAMPLED_FRAMES = 100
_SAMPLED_EDGE = 150


def episode_stats(columns: dict[str, NDArray[Any]]) -> dict[str, Stats]:
    """Return the statistics of columns of shape (rows, size) but for NaN; one with a number never measured has none."""
    stats: dict[str, Stats] = {}
    for name, values in columns.items():
        rows = values.astype(np.float64)
        is_known = np.isfinite(rows)
        rows[~is_known] = np.nan
        if is_known.any(axis=0).all():
            quantiles = np.nanquantile(rows, [*QUANTILES.values()], axis=0)
            found = {what: getattr(np, f"nan{what}")(rows, axis=0) for what in ("min", "max", "mean", "std")}
            found |= dict(zip(QUANTILES, quantiles, strict=True))
            stats[name] = {what: value.tolist() for what, value in found.items()} | {"count": [len(rows)]}
    return stats


class ImageHistogram:
    """A histogram of each channel's 256 values, over a sample of frames and pixels."""

    def __init__(self, frames: int = 0) -> None:
        """Start empty; of the `frames` that will be given to `add`, 100 are counted, evenly spaced."""
        self.sampled = 0
        self.counts = np.zeros((256, 3), np.int64)
        self._stride = max(1, math.ceil(frames / _SAMPLED_FRAMES))
        self._seen = 0

    def add(self, image: NDArray[Any]) -> None:
        """Add the next frame, (H, W, 3) uint8."""
        if self._seen % self._stride == 0:
            step = max(1, max(image.shape[:2]) // _SAMPLED_EDGE)
            sample = image[::step, ::step].reshape(-1, 3)
            self.counts += np.stack([np.bincount(channel, minlength=256) for channel in sample.T], axis=1)
            self.sampled += 1
        self._seen += 1

    def merge(self, other: ImageHistogram) -> None:
        """Add another histogram."""
        self.counts += other.counts
        self.sampled += other.sampled

    def stats(self) -> Stats:
        """Return the statistics of values from 0 to 1, each of shape (3, 1, 1)."""
        values, total = np.arange(256)[:, None] / 255, self.counts.sum(axis=0)
        mean = (self.counts * values).sum(axis=0) / total
        found = {"mean": mean, "std": np.sqrt((self.counts * (values - mean) ** 2).sum(axis=0) / total)}
        summed = self.counts.cumsum(axis=0)
        for name, share in {"min": 0.0, "max": 1.0, **QUANTILES}.items():
            places = np.round(share * (total - 1))
            found[name] = np.array([np.searchsorted(s, at, "right") for s, at in zip(summed.T, places, strict=True)])
            found[name] = found[name] / 255
        return {name: value.reshape(3, 1, 1).tolist() for name, value in found.items()} | {"count": [self.sampled]}


class DatasetStats:
    """The statistics of all episodes together; quantiles are those of `RunningStatistics`."""

    def __init__(self) -> None:
        """Start empty."""
        self._running: dict[str, RunningStatistics] = {}
        self._histograms: dict[str, ImageHistogram] = {}
        self._rows = 0

    def add(self, columns: dict[str, NDArray[Any]], histograms: dict[str, ImageHistogram]) -> None:
        """Add the next episode: its numbers by column, shape (rows, size), and its images."""
        self._rows += len(next(iter(columns.values())))
        for name, values in columns.items():
            running = self._running.setdefault(name, RunningStatistics(values.shape[1]))
            running.add(values[np.isfinite(values).all(axis=1)])
        for name, histogram in histograms.items():
            self._histograms.setdefault(name, ImageHistogram()).merge(histogram)

    def to_json(self) -> dict[str, Stats]:
        """Return the statistics by column, as in `stats.json`."""
        stats: dict[str, Stats] = {}
        for name, running in self._running.items():
            if running.count:
                whole = running.result()
                found = {what: getattr(whole, what) for what in ("min", "max", "mean", "std")}
                found |= dict(zip(QUANTILES, running.quantiles(tuple(QUANTILES.values())), strict=True))
                stats[name] = {what: value.tolist() for what, value in found.items()} | {"count": [self._rows]}
        return stats | {name: histogram.stats() for name, histogram in self._histograms.items()}
