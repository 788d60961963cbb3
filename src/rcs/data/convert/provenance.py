"""Where exported episodes came from, kept beside them in every format."""

from __future__ import annotations

from typing import Any

from rcs.data.reader import EpisodeRecord


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
        "quality": episode.quality,
        "source": about.get("source"),
    }
