"""`episode.json`: read here alone, and checked field by field, so that all other code may trust it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta
from typing_extensions import NotRequired, TypedDict

from rcs_data.errors import CorruptEpisode
from rcs_data.files.durable import unsealed
from rcs_data.files.info import refuse_other_schema
from rcs_data.files.json_file import check_fields, read_bytes
from rcs_data.files.layout import EPISODE_FILE, FRAMES_FILE, STEPS_FILE, is_name
from rcs_data.options import Natural

MOST_ROWS = 1 << 32
"""Rows of an episode; 30 Hz for four years."""
MOST_SEED = 1 << 128
"""Seeds are below this: `numpy.random.SeedSequence` makes 128 bits of them."""

Length = Annotated[int, Meta(ge=1, le=MOST_ROWS)]
Hash = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
"""A SHA-256 in hexadecimal."""


class Source(TypedDict):
    """The episode that one was made from."""

    dataset: str
    episode: str
    source: NotRequired[Source | None]


# Names of files, as `layout` has them.
Hashes = TypedDict("Hashes", {"steps.parquet": Hash, "frames.zip": NotRequired[Hash]})


class Period(TypedDict):
    """The timing report's periods [s], as `TimingMeter` measures them."""

    expected: float
    mean: float
    p50: float
    p99: float
    max: float
    jitter_p50: float
    jitter_p99: float
    jitter_max: float
    gaps: float
    missed_steps: float
    backwards: float


class Timing(TypedDict):
    """The timing report."""

    period: NotRequired[Period | None]
    cameras: NotRequired[dict[str, dict[str, Natural | None]] | None]
    devices: NotRequired[dict[str, Any] | None]
    writer: NotRequired[dict[str, float] | None]


class About(TypedDict):
    """The fields of an `episode.json`."""

    id: str
    seed: int | None
    success: bool | None
    length: Length
    outcome: dict[str, Any]
    instruction: str
    started: str | None
    ended: str | None
    versions: dict[str, str]
    content_hash: Hash
    sha256: Hashes
    timing: Timing
    source: NotRequired[Source | None]


# msgspec takes a type apart when it first sees it, and two threads that do so at once end the process.
msgspec.json.Decoder(About)


def read_about(folder: Path) -> dict[str, Any]:
    """Read the `episode.json` in an episode's folder.

    Raises:
        CorruptEpisode: It is missing, was changed, or has impossible values.
        DatasetError: Its layout is of another version.
    """
    path = folder / EPISODE_FILE
    return checked_about(unsealed(read_bytes(path), path), path)


def checked_about(values: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the fields of an `episode.json` after checking them.

    Args:
        values: Its fields.
        path: Where it is, for the message.

    Raises:
        CorruptEpisode: A field is missing or not valid; the message names it.
        DatasetError: Its layout is of another version.
    """
    refuse_other_schema(values.get("schema_version"), f"episode, {path.parent},")
    try:
        check_fields(values, About)
        if strange := set(values["sha256"]) - {STEPS_FILE, FRAMES_FILE}:
            raise msgspec.ValidationError(f"sha256 has {sorted(strange)}")
        if abs(values["seed"] or 0) >= MOST_SEED:
            raise msgspec.ValidationError(f"seed is {values['seed']}; valid is a whole number of up to 128 bits")
        source = values.get("source")
        while source is not None:  # whose names may become folders' names
            if not is_name(source["dataset"]) or not is_name(source["episode"]):
                raise msgspec.ValidationError(f"source is {source!r:.80}; valid are names of a dataset and an episode")
            source = source.get("source")
    except msgspec.ValidationError as err:
        raise CorruptEpisode(f"{path} is damaged: {err}.") from err
    return values
