"""Texts per row, such as the subtask of each step: a column of whole numbers, and their meaning in the outcome.

The feature has a number per row, from 0 in every episode; the episode's outcome says what it stands for:
`outcome["labels"]["extra/subtask_index"]` is `["reach", "grasp"]`. So the texts stay with their episode when datasets
are merged, split or edited.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode
from rcs_data.read.reader import EpisodeRecord

LABELS = "labels"
"""Key of an outcome: texts by feature."""


def numbered(texts: Sequence[str]) -> tuple[NDArray[np.int32], list[str]]:
    """Return a number for each text, shape (rows,), and the different texts in the order in which they appear."""
    known = {text: number for number, text in enumerate(dict.fromkeys(texts))}
    return np.array([known[text] for text in texts], np.int32), list(known)


def labels(episode: EpisodeRecord) -> dict[str, list[str]]:
    """Return the texts of an episode's numbers by feature; empty if it has none."""
    found: Any = episode.outcome.get(LABELS)
    return found if isinstance(found, dict) else {}


def row_texts(episode: EpisodeRecord, key: str) -> list[str]:
    """Return the text of every row.

    Args:
        episode: The episode.
        key: The feature, such as "extra/subtask_index".

    Raises:
        InvalidSetup: There is no such feature.
        CorruptEpisode: The outcome does not say what its numbers mean.
    """
    numbers, texts = episode.column(key), labels(episode).get(key)
    if not isinstance(texts, list) or not all(0 <= n < len(texts) for n in np.unique(numbers)):
        raise CorruptEpisode(f"The outcome of episode {episode.id!r} does not say what the numbers of {key!r} mean.")
    return [str(texts[number]) for number in numbers]
