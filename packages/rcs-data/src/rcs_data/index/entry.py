"""The entry of an episode in the index: a line of `episodes.jsonl`, with its checksum inside."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.files.info import DatasetInfo

T = TypeVar("T")
_CHECKSUM = b',"checksum":"'


class Entry(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """The entry of an episode in the index, so that most questions need no other file."""

    id: str
    """The name, unique in the dataset."""
    folder: str
    """The folder's name: the id, or the id and the number of what wrote it."""
    length: int
    """Rows."""
    success: bool | None
    """Whether the task was done; None if that is not known."""
    seed: int | None
    """The seed of the reset."""
    content_hash: str
    """As in `episode.json`."""
    instruction: str | None
    """The instruction that the robot had; None for the dataset's instruction."""
    failure: str | None
    """Why it failed, as the outcome says."""

    @classmethod
    def of(cls, about: Mapping[str, Any], folder: str, info: DatasetInfo) -> Entry:
        """Return the entry of an episode, given the contents of its `episode.json`."""
        failure = about["outcome"].get("failure")
        kept = {name: about[name] for name in ("id", "length", "success", "seed", "content_hash")}
        instruction = None if about["instruction"] == info.instruction else about["instruction"]
        return cls(
            **kept, folder=folder, instruction=instruction, failure=failure if isinstance(failure, str) else None
        )

    @property
    def line(self) -> bytes:
        """The entry as a line of the index."""
        return sealed_line(self)


def sealed_line(values: msgspec.Struct) -> bytes:
    """Return a record as a line whose last field, `checksum`, is the CRC-32 of what is before it.

    Raises:
        InvalidSetup: A text cannot be stored.
    """
    try:
        text = msgspec.json.encode(values)[:-1]
    except UnicodeEncodeError as err:
        raise InvalidSetup(f"A text cannot be stored: {err}.") from err
    return b'%b%b%08x"}\n' % (text, _CHECKSUM, zlib.crc32(text))


def unsealed(line: bytes, decoder: msgspec.json.Decoder[T]) -> T:
    """Return the record that `sealed_line` made a line of, without its line break.

    Raises:
        ValueError: The line is damaged, or makes no sense.
    """
    text, mark, checksum = line[:-23], line[-23:-10], line[-10:]
    if mark != _CHECKSUM or checksum != b'%08x"}' % zlib.crc32(text):
        raise ValueError("its checksum does not match")
    try:
        return decoder.decode(line)
    except msgspec.MsgspecError as err:  # which before version 0.21 is no ValueError
        raise ValueError(str(err)) from err


def entry_of(line: bytes, path: Path, number: int) -> Entry:
    """Return the entry in a line.

    Args:
        line: Its bytes without the line break.
        path: The file, for the message.
        number: The number of the line, from 1.

    Raises:
        CorruptEpisode: The line is damaged, or makes no sense.
    """
    try:
        entry = unsealed(line, _DECODER)
        if "/" in entry.folder or "/" in entry.id or "." in (entry.folder[:1], entry.id[:1]):
            raise ValueError(f"{entry.id!r} in {entry.folder!r} is no episode")  # but a way out of the folder
    except ValueError as err:
        raise CorruptEpisode(
            f"{path} is damaged in line {number}: {err}. `rcs-data check --repair` takes the episode from its folder."
        ) from err
    return entry


_DECODER = msgspec.json.Decoder(Entry)
