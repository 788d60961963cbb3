"""A line of a ledger: an episode that ended, in plain columns, with a checksum."""

from __future__ import annotations

from pathlib import Path

import msgspec

from rcs_data.errors import CorruptEpisode
from rcs_data.index.entry import sealed_line, unsealed
from rcs_data.ledger.condition import named

TIMES = ("latency_p50", "latency_p99", "seconds", "ended")
"""Columns that are measured by the clock, so that they differ where the same episode runs twice."""


class Row(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """An episode that ended. Its key is what it depends on; its other columns are its result."""

    key: str
    """Hash of the condition and seed, as `key_of` joins them."""
    repeat: int = 0
    """How often the key had been run before, by wish."""
    condition: str
    """Hash of the condition, which is described in `conditions/<hash>.json`."""
    seed: int
    """Seed of the reset."""
    agent: str
    """Name of the agent."""
    weights: str | None
    """SHA-256 of its weights."""
    trained: int | None
    """Steps that its training had made."""
    data: str | None = None
    """Hash of the data that it was trained on."""
    task: str
    """Name of the task."""
    robot: str
    """Name of the robot."""
    is_real: bool
    """Whether anything was real."""
    success: bool | None
    """Whether the task was done; None without a verdict."""
    failure: str | None
    """Class of the failure."""
    message: str | None
    """The agent's, or the judge's, words on it."""
    judge: str
    """The judge: `task`, `person`, or `nobody`."""
    stages: int | None = None
    """Stages of the task that were reached, counted by the judge; None if nobody counted."""
    tags: tuple[str, ...] = ()
    """Tags that the judge gave."""
    corrections: int = 0
    """How often the answer had been taken back before: the line with the most counts."""
    steps: int
    """Steps."""
    reward: float | None
    """Sum of the rewards; None if it was not finite."""
    latency_p50: float | None
    """Median of the time that answers of the policy took [s]; None if no policy answered."""
    latency_p99: float | None
    """The 99th percentile of it [s]."""
    seconds: float
    """Duration by the clock [s]."""
    ended: str
    """When it ended: date and time in UTC, as ISO 8601 has it."""

    @property
    def name(self) -> str:
        """The key, and the number of the repetition if it is one."""
        return named(self.key, self.repeat)

    @property
    def line(self) -> bytes:
        """The row as a line of the ledger."""
        return sealed_line(self)


def row_of(line: bytes, path: Path, number: int) -> Row:
    """Return the row in a line.

    Args:
        line: Its bytes without the line break.
        path: The file, for the message.
        number: The number of the line, from 1.

    Raises:
        CorruptEpisode: The line is damaged, or makes no sense.
    """
    try:
        return unsealed(line, _DECODER)
    except ValueError as err:
        raise CorruptEpisode(f"Line {number} of {path} is left out: {err}.") from err


_DECODER = msgspec.json.Decoder(Row)
