"""Checks that `dataset.json`, its copy and `episode.json` are what was written, byte for byte."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rcs_data.check.report import Finding
from rcs_data.durable import sealed, unsealed
from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.head import Head, read_head_file
from rcs_data.json_file import read_bytes
from rcs_data.layout import COPY_FILE, DATASET_FILE
from rcs_data.lock import is_locked

# `dataset.json` has a copy from this layout on.
_FIRST_WITH_COPY = 2


def is_as_written(data: bytes, values: dict[str, Any]) -> bool:
    """Return whether the bytes of sealed JSON are exactly those that its values are written as.

    A changed space, or E instead of e in a number, does not change the values nor their checksum.
    """
    return sealed(values) == data


def check_head(root: Path) -> tuple[Head | None, list[Finding]]:
    """Check `dataset.json` and its copy; return their contents, or None if neither can be read.

    Args:
        root: The dataset's folder.

    Raises:
        DatasetError: There is no dataset, or its layout is newer than this code.
    """
    if not (root / DATASET_FILE).exists() and not (root / COPY_FILE).exists():
        raise DatasetError(f"There is no dataset in {root}: {DATASET_FILE} is missing.")
    heads: dict[str, Head] = {}
    findings: list[Finding] = []
    for name in (DATASET_FILE, COPY_FILE):
        if not (root / name).exists():
            has_copy = name == DATASET_FILE or _is_copy_expected(heads.get(DATASET_FILE))
            findings += [_finding(name, "missing", "missing; rcs data check --repair restores it")] if has_copy else []
            continue
        try:
            heads[name] = read_head_file(root / name)
        except CorruptEpisode as err:
            findings.append(_finding(name, "altered", str(err)))
            continue
        data = read_bytes(root / name)
        if not is_as_written(data, unsealed(data, root / name)):
            findings.append(_finding(name, "altered", "is readable, but its bytes are not those that were written"))
    if len(heads) == 2 and heads[DATASET_FILE] != heads[COPY_FILE] and not is_locked(root):
        message = f"older than {DATASET_FILE}: the writer was killed between the two; `rcs data recover` updates it"
        findings.append(Finding(severity="warning", kind="stale_copy", episode=None, file=COPY_FILE, message=message))
    return next(iter(heads.values()), None), findings


def _is_copy_expected(head: Head | None) -> bool:
    return head is None or head.info.schema_version >= _FIRST_WITH_COPY


def _finding(name: str, kind: str, message: str) -> Finding:
    return Finding(severity="damage", kind=kind, episode=None, file=name, message=message)
