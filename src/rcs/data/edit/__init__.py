"""Edits of recorded datasets: each takes effect in one step, is listed in the history, and can be undone."""

from __future__ import annotations

from rcs.data.edit.combine import merge, split
from rcs.data.edit.episodes import delete, keep, relabel, trim
from rcs.data.edit.images import rename_camera, resize
from rcs.data.edit.mix import Harmonise, Part, mix, parse_part
from rcs.data.edit.rate import resample
from rcs.data.edit.undo import prune, undo

__all__ = [
    "Harmonise",
    "Part",
    "delete",
    "keep",
    "merge",
    "mix",
    "parse_part",
    "prune",
    "relabel",
    "rename_camera",
    "resample",
    "resize",
    "split",
    "trim",
    "undo",
]
