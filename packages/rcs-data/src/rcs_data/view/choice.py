"""Which episodes are meant by ids and patterns."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase

from rcs_data.errors import InvalidSetup
from rcs_data.reader import Dataset, EpisodeRecord


def chosen_episodes(dataset: Dataset, patterns: Sequence[str] | None) -> list[EpisodeRecord]:
    """Return the episodes that are meant, in the dataset's order.

    Args:
        dataset: The dataset.
        patterns: Ids, or patterns such as "0001*"; None for all episodes.

    Raises:
        InvalidSetup: No episode fits one of them.
    """
    if patterns is None:
        return list(dataset.episodes)
    for pattern in patterns:
        if not any(_fits(episode, pattern) for episode in dataset.episodes):
            raise InvalidSetup(f"No episode of {dataset.path} is named {pattern!r}; it has {len(dataset)} episodes.")
    return [episode for episode in dataset.episodes if any(_fits(episode, pattern) for pattern in patterns)]


def _fits(episode: EpisodeRecord, pattern: str) -> bool:
    return episode.id == pattern or fnmatchcase(episode.id, pattern)
