"""The origin of exported episodes, stored beside them in every format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rcs_data.about import MOST_ROWS, MOST_SEED
from rcs_data.errors import CorruptEpisode
from rcs_data.layout import is_name
from rcs_data.reader import EpisodeRecord

FIELDS = ("episode", "seed", "success", "outcome", "instruction", "rows")
"""Fields that an import needs."""


def episode_provenance(episode: EpisodeRecord, digest: str) -> dict[str, Any]:
    """Return the origin of an exported episode, and what its format has no place for, as JSON values.

    Args:
        episode: The episode.
        digest: That of its dataset, as `Dataset.digest` returns it.

    Raises:
        CorruptEpisode: The episode's description is damaged.
    """
    about = episode.about
    return {
        "dataset": digest,
        "episode": episode.id,
        "content_hash": episode.content_hash,
        "seed": episode.seed,
        "success": episode.success,
        "outcome": episode.outcome,
        "instruction": episode.instruction,
        "rows": episode.length,
        "recorded": about.get("started"),
        "timing": episode.timing,
        "source": about.get("source"),
    }


def checked_provenance(values: Any, path: Path | str) -> dict[str, Any]:
    """Return checked values of `episode_provenance` that a file stored.

    Raises:
        CorruptEpisode: A field is missing or not valid.
    """
    if not isinstance(values, dict):
        raise CorruptEpisode(f"{path} is damaged: it has {values!r:.80} for an episode.")
    given: dict[str, Any] = values
    if missing := [field for field in FIELDS if field not in given]:
        raise CorruptEpisode(f"{path} is damaged: an episode lacks {', '.join(missing)}.")
    seed, rows, name = given["seed"], given["rows"], given["episode"]
    is_right = {
        "episode": isinstance(name, str) and is_name(name),
        "seed": seed is None or (type(seed) is int and abs(seed) < MOST_SEED),
        "success": given["success"] is None or isinstance(given["success"], bool),
        "outcome": isinstance(given["outcome"], dict),
        "instruction": isinstance(given["instruction"], str),
        "rows": type(rows) is int and 1 <= rows <= MOST_ROWS,
    }
    for field, right in is_right.items():
        if not right:
            raise CorruptEpisode(f"{path} is damaged: {field} of an episode is {given[field]!r:.80}.")
    return given
