"""All formats by name: how to write, read and recognise them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rcs_data.convert.aloha import import_aloha, is_aloha
from rcs_data.convert.hdf5 import is_hdf5
from rcs_data.convert.lerobot import export_lerobot
from rcs_data.convert.lerobot_import import import_lerobot, is_lerobot
from rcs_data.convert.mcap import export_mcap
from rcs_data.convert.options import ExportOptions, ExportReport, ImportOptions
from rcs_data.convert.rlds import export_rlds
from rcs_data.convert.rlds_import import import_rlds, is_rlds
from rcs_data.convert.robomimic import export_robomimic
from rcs_data.convert.robomimic_import import import_robomimic
from rcs_data.errors import InvalidSetup, UnknownName
from rcs_data.layout import check_path
from rcs_data.reader import Dataset

Export = Callable[[Dataset, Path, ExportOptions], ExportReport]
Import = Callable[[Path, Path, ImportOptions], Dataset]


@dataclass(frozen=True, kw_only=True)
class ImportFormat:
    """A format that can be read."""

    recognise: Callable[[Path], bool]
    """Whether a file or folder looks like this format; reads only a few bytes."""
    read: Import
    """Makes a dataset of it."""


# A line per format.
EXPORTS: dict[str, Export] = {
    "lerobot-v3": partial(export_lerobot, version="3.0"),
    "lerobot-v2.1": partial(export_lerobot, version="2.1"),
    "gr00t": partial(export_lerobot, version="2.1", gr00t=True),
    "rlds": export_rlds,
    "robomimic": export_robomimic,
    "mcap": export_mcap,
}

IMPORTS: dict[str, ImportFormat] = {
    "lerobot": ImportFormat(recognise=is_lerobot, read=import_lerobot),
    "rlds": ImportFormat(recognise=is_rlds, read=import_rlds),
    "aloha": ImportFormat(recognise=is_aloha, read=import_aloha),
    "robomimic": ImportFormat(recognise=is_hdf5, read=import_robomimic),
}


def export_format(name: str) -> Export:
    """Return the function that exports to a format.

    Raises:
        UnknownName: There is no such format.
    """
    if name not in EXPORTS:
        raise UnknownName("format to export to", name, EXPORTS)
    return EXPORTS[name]


def import_format(name: str, source: Path) -> Import:
    """Return the function that imports a format.

    Args:
        name: The format, or "auto" to look at the source.
        source: The file or folder to import.

    Raises:
        UnknownName: There is no such format.
        InvalidSetup: The name is "auto", and the source looks like none of them.
        DatasetError: The path of the source is not UTF-8.
    """
    check_path(source)
    if name == "auto":
        for format_ in IMPORTS.values():
            if format_.recognise(source):
                return format_.read
        raise InvalidSetup(f"Cannot recognise the format of {source}; valid: {', '.join(IMPORTS)}.")
    if name not in IMPORTS:
        raise UnknownName("format to import from", name, [*IMPORTS, "auto"])
    return IMPORTS[name].read
