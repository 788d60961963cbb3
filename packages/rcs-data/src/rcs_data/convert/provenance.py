"""The origin of exported episodes, stored beside them in every format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
from typing_extensions import TypedDict

from rcs_data.errors import CorruptEpisode
from rcs_data.files.json_file import check_fields
from rcs_data.files.layout import is_name
from rcs_data.read.reader import EpisodeRecord


class Provenance(TypedDict):
    """The fields that an import needs."""

    episode: str
    seed: int | None
    success: bool | None
    outcome: dict[str, Any]
    instruction: str
    rows: Annotated[int, msgspec.Meta(ge=1)]


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
    """Return values of `episode_provenance` that a file stored; CorruptEpisode if a field is missing or not valid."""
    try:
        check_fields(values, Provenance)
        if not is_name(values["episode"]):
            raise msgspec.ValidationError("the id of an episode cannot be a folder's name")
    except msgspec.ValidationError as err:
        raise CorruptEpisode(f"{path} is damaged: {err}.") from err
    return values
