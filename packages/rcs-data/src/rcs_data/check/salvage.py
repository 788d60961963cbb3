"""Salvages a damaged episode: its rows up to the damage, and its description."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from rcs_data import parquet
from rcs_data.about import checked_about, read_about
from rcs_data.check.bitrot import mended_json, mended_parquet
from rcs_data.check.bytes import schemas_of, sha256_of
from rcs_data.codec import decode_frame
from rcs_data.content import ContentHash
from rcs_data.errors import CorruptEpisode
from rcs_data.info import DatasetInfo
from rcs_data.json_file import read_bytes
from rcs_data.layout import EPISODE_FILE, SIM_STATE_FILE, STEPS_FILE
from rcs_data.parquet import UNREADABLE
from rcs_data.rows import SIM_STATE, sim_state_schema
from rcs_data.text import mended_text


@dataclass(frozen=True, kw_only=True)
class Salvage:
    """The readable part of an episode."""

    about: dict[str, Any]
    """Fields for its `episode.json`, other than those computed from the rows."""
    rows: pa.Table
    """Its rows up to the damage, with the columns of `stream_schema`; none if nothing is readable."""
    content_hash: str
    """The content hash of these rows."""
    is_exact: bool
    """Whether these are all its rows, bit for bit; simulation states may be lost."""
    is_whole: bool
    """Whether nothing of the episode is lost."""
    said: str
    """What was done, in words."""


def salvage(folder: Path, info: DatasetInfo, *, others: Sequence[Path] = ()) -> Salvage:
    """Read what is readable of an episode.

    Args:
        folder: The episode's folder.
        info: What the dataset's episodes share.
        others: Folders of the same episode in other generations, which may have intact files.

    Raises:
        DatasetError: Its layout is newer than this code, which is not damage.
    """
    about, is_certain, said = _description(folder, others)
    hashes: Any = about.get("sha256") if about is not None else None
    files: dict[str, Path | pa.Buffer] = {}
    for name in schemas_of(info):
        expected = hashes.get(name) if isinstance(hashes, dict) else None
        files[name], words = _as_it_was(folder / name, expected, [other / name for other in others])
        said += words
    try:
        rows = _readable_rows(files[STEPS_FILE], info)
    except (*UNREADABLE, ValueError, IndexError):  # a contradictory footer
        rows = schemas_of(info)[STEPS_FILE].empty_table()
    content = ContentHash(info)
    content.add(rows)
    is_exact = about is not None and content.hexdigest() == about.get("content_hash")
    if about is None:
        said.append("episode.json was restored from the rows, without a verdict")
        about = _rebuilt(folder, info)
    elif not is_exact:
        said.append(f"{rows.num_rows} of {about.get('length')} rows are kept, without a verdict")
        about = {**about, "success": None, "outcome": _outcome(about, rows.num_rows)}
    lost = 0
    if info.sim_state_size is not None:
        rows, lost = _with_states(rows, files[SIM_STATE_FILE], info.sim_state_size)
        said += [f"{lost} of its simulation states cannot be read and are NaN"] if lost else []
    return Salvage(
        about=about,
        rows=rows,
        content_hash=content.hexdigest(),
        is_exact=is_exact,
        is_whole=is_certain and is_exact and not lost,
        said="; ".join(said) or "its files were written again with the same values",
    )


def _description(folder: Path, others: Sequence[Path]) -> tuple[dict[str, Any] | None, bool, list[str]]:
    """Return the contents of `episode.json`, whether they are certain, and how they were found."""
    path = folder / EPISODE_FILE
    try:
        return read_about(folder), True, []
    except CorruptEpisode:
        about = _mended_about(path)
        if about is not None:
            return about, True, [f"the one changed bit of {EPISODE_FILE} was restored"]
        # Otherwise another generation may have it.
    for other in others:
        try:
            about = read_about(other)
            if all(sha256_of(folder / name) == expected for name, expected in about["sha256"].items()):
                # An edit in between may have changed its texts, though not the rows.
                return about, False, [f"{EPISODE_FILE} was taken from another generation"]
        except (CorruptEpisode, OSError):
            continue
    return None, False, []


def _mended_about(path: Path) -> dict[str, Any] | None:
    """Return an `episode.json` before one bit of it changed; None if that does not explain the damage."""
    try:
        about = mended_json(read_bytes(path), path)
        return None if about is None else checked_about(about, path)
    except CorruptEpisode:
        return None


def _as_it_was(path: Path, expected: Any, others: Sequence[Path]) -> tuple[Path | pa.Buffer, list[str]]:
    """Return a file, restored if possible, and how it was restored, if it was."""
    if not isinstance(expected, str) or _hash_or_none(path) == expected:
        return path, []
    for other in others:
        if _hash_or_none(other) == expected:
            return other, [f"{path.name} was taken from another generation"]
    try:
        data = mended_parquet(path.read_bytes(), expected) if path.is_file() else None
    except OSError:
        return path, []
    if data is None:
        return path, []
    return pa.py_buffer(data), [f"the one changed byte of {path.name} was restored"]


def _hash_or_none(path: Path) -> str | None:
    try:
        return sha256_of(path)
    except OSError:
        return None


def _with_states(rows: pa.Table, source: Path | pa.Buffer, size: int) -> tuple[pa.Table, int]:
    """Return the rows with their simulation states, and how many of these are lost and NaN."""
    try:
        states = _readable_states(source, size)[: rows.num_rows]
    except (*UNREADABLE, ValueError, IndexError):
        states = np.empty((0, size))
    lost = rows.num_rows - len(states)
    flat = pa.array(np.concatenate([states, np.full((lost, size), np.nan)]).reshape(-1))
    field = sim_state_schema(size).field(SIM_STATE)
    return rows.append_column(field, pa.FixedSizeListArray.from_arrays(flat, size)), lost


def _rebuilt(folder: Path, info: DatasetInfo) -> dict[str, Any]:
    """Return a description made from the rows and from what is readable in the old one's text."""
    try:
        text = read_bytes(folder / EPISODE_FILE).decode(errors="replace")
    except CorruptEpisode:
        text = ""
    seed = re.search(r'^ "seed": (\d{1,38}),$', text, re.MULTILINE)
    words = re.search(r'^ "instruction": ("(?:[^"\\]|\\.)*"),$', text, re.MULTILINE)
    started = re.search(r'^ "started": "([0-9T:.+-]+)",$', text, re.MULTILINE)
    found = {"seed": seed, "instruction": words, "started": started}
    unverified = [name for name, match in found.items() if match is not None]
    return {
        "id": folder.name,
        "seed": None if seed is None else int(seed[1]),
        "success": None,
        "outcome": {"repaired": True, **({"unverified": unverified} if unverified else {})},
        "instruction": info.instruction if words is None else _text(words[1], info.instruction),
        "started": None if started is None else started[1],
        "ended": None,
        "versions": {},
        "timing": {},
    }


def _text(quoted: str, otherwise: str) -> str:
    try:
        return mended_text(str(json.loads(quoted)))
    except (ValueError, RecursionError):
        return otherwise


def _outcome(about: dict[str, Any], rows: int) -> dict[str, Any]:
    former = {"rows": about.get("length"), "success": about.get("success"), "outcome": about.get("outcome")}
    return {"repaired": True, "rows": rows, "former": former}


def _readable_rows(source: Path | pa.Buffer, info: DatasetInfo) -> pa.Table:
    """Return the rows before the first that cannot be read or whose image does not decode."""
    schema = schemas_of(info)[STEPS_FILE]
    groups: list[pa.Table] = []
    for group in _groups(source, schema):
        columns = [_readable(source, group, key, info) for key in schema.names]
        rows = min(len(column) for column in columns)
        groups.append(pa.Table.from_arrays([column.slice(0, rows) for column in columns], schema=schema))
        if rows < _length(source, group):
            break
    return pa.concat_tables(groups).combine_chunks() if groups else schema.empty_table()


def _readable_states(source: Path | pa.Buffer, size: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    schema = sim_state_schema(size)
    columns: list[np.ndarray[Any, np.dtype[np.float64]]] = [np.empty((0, size))]
    for group in _groups(source, schema):
        column = _prefix(source, group, SIM_STATE)
        columns.append(column.combine_chunks().flatten().to_numpy().reshape(-1, size))
        if len(column) < _length(source, group):
            break
    return np.concatenate(columns)


def _groups(source: Path | pa.Buffer, schema: pa.Schema) -> range:
    try:
        with parquet.opened(source) as opened:
            opened.require(is_damaged=True)  # nothing is kept of a file that claims gigabytes
            return range(opened.file.num_row_groups if opened.file.schema_arrow.equals(schema) else 0)
    except (*UNREADABLE, CorruptEpisode):
        return range(0)


def _length(source: Path | pa.Buffer, group: int) -> int:
    with parquet.opened(source) as opened:
        return opened.file.metadata.row_group(group).num_rows


def _readable(source: Path | pa.Buffer, group: int, key: str, info: DatasetInfo) -> pa.ChunkedArray:
    """Return the values of a column in a row group, up to the damage."""
    column = _prefix(source, group, key)
    feature = info.feature(key)
    if not feature.is_image:
        return column
    whole = len(column) == _length(source, group)
    if not whole:
        # Despite a page's checksum: images before the first that does not decode. If all decode, any may be damaged.
        column = _prefix(source, group, key, verify=False)
    for row, image in enumerate(column):
        try:
            if image.is_valid:
                decode_frame(feature, image.as_py())
        except CorruptEpisode:
            # The image just before a broken one may be damaged too.
            return column.slice(0, row if whole else max(row - 1, 0))
    return column if whole else column.slice(0, 0)


def _prefix(source: Path | pa.Buffer, group: int, key: str, *, verify: bool = True) -> pa.ChunkedArray:
    """Return the values of a column in a row group before the first unreadable page."""
    batches: list[pa.Array] = []
    with parquet.opened(source, verify=verify) as opened:
        kind = opened.file.schema_arrow.field(key).type
        with suppress(*UNREADABLE, CorruptEpisode):
            return opened.table([key], [group]).column(0)
        try:
            opened.require([key], [group], is_damaged=True)
            batches.extend(piece.column(0) for piece in opened.batches([key], [group]))  # up to the error
        except (*UNREADABLE, CorruptEpisode):
            pass  # what precedes the error is the result
    return pa.chunked_array(batches, type=kind)
