"""Where exported episodes came from, kept beside them in every format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rcs.data.about import MOST_ROWS, MOST_SEED
from rcs.data.layout import is_name
from rcs.data.reader import EpisodeRecord
from rcs.errors import CorruptEpisode

FIELDS = ("episode", "seed", "success", "outcome", "instruction", "rows")
"""What an import relies on."""


def episode_provenance(episode: EpisodeRecord, digest: str) -> dict[str, Any]:
    """Return as JSON values where an exported episode came from, and what its format has no place for.

    Args:
        episode: The episode.
        digest: The digest of its dataset, as `Dataset.digest` returns it.

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
    """Return what `episode_provenance` returned and a format kept, if it can be true.

    Args:
        values: What was kept.
        path: Where it is, for the message.

    Raises:
        CorruptEpisode: A field is missing or not what it must be.
    """
    if not isinstance(values, dict):
        raise CorruptEpisode(f"{path} is damaged: of an episode it has {values!r:.80}.")
    given: dict[str, Any] = values
    if missing := [field for field in FIELDS if field not in given]:
        raise CorruptEpisode(f"{path} is damaged: of an episode it does not say {', '.join(missing)}.")
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


def by_episode(rows: Any, path: Path) -> dict[int, dict[str, Any]]:
    """Return rows of a file beside an export by the number of their episode.

    Raises:
        CorruptEpisode: A row has no such number.
    """
    if not isinstance(rows, list):
        raise CorruptEpisode(f"{path} is damaged: it has {rows!r:.80} in the place of its episodes.")
    found: dict[int, dict[str, Any]] = {}
    for row in rows:
        index = row.get("episode_index") if isinstance(row, dict) else None
        if type(index) is not int:
            raise CorruptEpisode(f"{path} is damaged: {row!r:.80} has no whole number episode_index.")
        found[index] = row
    return found
