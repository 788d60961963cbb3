"""All formats by name: how to write, recognise and read them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from rcs_data.convert.hdf5.aloha import import_aloha, is_aloha
from rcs_data.convert.hdf5.arrays import is_hdf5
from rcs_data.convert.hdf5.robomimic import export_robomimic
from rcs_data.convert.hdf5.robomimic_import import import_robomimic
from rcs_data.convert.lerobot.export import export_lerobot
from rcs_data.convert.lerobot.import_ import import_lerobot, is_lerobot
from rcs_data.convert.mcap.export import export_mcap
from rcs_data.convert.options import ExportOptions, ExportReport, ImportOptions
from rcs_data.convert.rlds.export import export_rlds
from rcs_data.convert.rlds.import_ import import_rlds, is_rlds
from rcs_data.errors import InvalidSetup, UnknownName
from rcs_data.files.layout import check_path
from rcs_data.read.reader import Dataset

Export = Callable[[Dataset, Path, ExportOptions], ExportReport]
Import = Callable[[Path, Path, ImportOptions], Dataset]

EXPORTS: dict[str, Export] = {
    "lerobot-v3": partial(export_lerobot, version="3.0"),
    "lerobot-v2.1": partial(export_lerobot, version="2.1"),
    "gr00t": partial(export_lerobot, version="2.1", gr00t=True),
    "rlds": export_rlds,
    "robomimic": export_robomimic,
    "mcap": export_mcap,
}
"""Formats that can be written."""

IMPORTS: dict[str, tuple[Callable[[Path], bool], Import]] = {
    "lerobot": (is_lerobot, import_lerobot),
    "rlds": (is_rlds, import_rlds),
    "aloha": (is_aloha, import_aloha),
    "robomimic": (is_hdf5, import_robomimic),
}
"""Formats that can be read: a test of a few bytes whether a file or folder looks like it, and the import."""


def export_format(name: str) -> Export:
    """Return the function that exports to a format; UnknownName if there is none."""
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
    if name != "auto" and name not in IMPORTS:
        raise UnknownName("format to import from", name, [*IMPORTS, "auto"])
    for known, (looks_like, read) in IMPORTS.items():
        if known == name or (name == "auto" and looks_like(source)):
            return read
    raise InvalidSetup(f"Cannot recognise the format of {source}; valid: {', '.join(IMPORTS)}.")
