"""By how much the ways of arms differ from episode to episode."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs_data.errors import CorruptEpisode
from rcs_data.info import DatasetInfo
from rcs_data.reader import EpisodeRecord

COMPARED = 64
"""Points at which two ways are compared."""
MOST_EPISODES = 50
"""Episodes of a dataset that are compared, evenly spread: each with each are 1225 pairs."""
JOINTS = "joints"


def at_shares(rows: NDArray[np.float64], shares: ArrayLike) -> NDArray[np.float64]:
    """Return points (..., dof) at shares of the length, 0 … 1, of the straight lines that connect rows (n, dof)."""
    way = np.concatenate([[0.0], np.linalg.norm(np.diff(rows, axis=0), axis=1).cumsum()])
    wanted = np.asarray(shares, np.float64) * way[-1]
    return np.stack([np.interp(wanted, way, column) for column in rows.T], axis=-1)


def diversity_of_ways(ways: Sequence[NDArray[np.float64]]) -> float:
    """Return the mean over all pairs of the RMS distance at equal shares of the length, in the unit of the rows.

    Each of the ways, at least two of at least two rows (n, dof), is compared by its way alone: stretched from its own
    start to its own goal, so that goals that differ do not count as different ways. Straight motions give 0.
    """
    shares = np.linspace(0.0, 1.0, COMPARED)
    bent: list[NDArray[np.float64]] = []
    for rows in ways:
        points = at_shares(rows, shares)
        bent.append(points - (points[0] + shares[:, None] * (points[-1] - points[0])))
    apart = [float(np.sqrt(((a - b) ** 2).sum(-1).mean())) for i, a in enumerate(bent) for b in bent[:i]]
    return float(np.mean(apart))


def ways_of(info: DatasetInfo, episodes: Sequence[EpisodeRecord]) -> list[NDArray[np.float64]]:
    """Return the measured joints of up to `MOST_EPISODES` episodes [rad], (rows, joints of all robots) each.

    Episodes that are damaged, or have fewer than two rows of finite numbers, are left out; without joints, all are.
    """
    keys = [
        feature.key
        for feature in info.features
        if feature.key.startswith("observation/") and feature.key.rsplit("/", 1)[1] == JOINTS
    ]
    if not keys:
        return []
    chosen = np.unique(np.linspace(0, len(episodes) - 1, MOST_EPISODES).round().astype(int)) if episodes else []
    ways: list[NDArray[np.float64]] = []
    for number in chosen:
        episode = episodes[int(number)]
        try:
            columns = [np.asarray(episode.column(key), np.float64).reshape(episode.length, -1) for key in keys]
        except CorruptEpisode:
            continue
        rows = np.hstack(columns)
        rows = rows[np.isfinite(rows).all(axis=1)]
        if len(rows) > 1:
            ways.append(rows)
    return ways
