"""Pages to look at a dataset with, in a browser and without a network."""

from __future__ import annotations

from rcs_data.view.clips import ClipOptions, Codec
from rcs_data.view.page import VIEW_FOLDER, ViewReport, write_report, write_view

__all__ = [
    "VIEW_FOLDER",
    "ClipOptions",
    "Codec",
    "ViewReport",
    "write_report",
    "write_view",
]
