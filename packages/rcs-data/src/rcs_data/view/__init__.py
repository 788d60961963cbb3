"""Pages to look at a dataset with, in a browser and without a network."""

from __future__ import annotations

from rcs_data.view.clips import ClipOptions, Codec
from rcs_data.view.gallery import pictures_page
from rcs_data.view.notebook import picture_tag
from rcs_data.view.page import VIEW_FOLDER, ViewReport, write_view
from rcs_data.view.report import write_report

__all__ = [
    "VIEW_FOLDER",
    "ClipOptions",
    "Codec",
    "ViewReport",
    "picture_tag",
    "pictures_page",
    "write_report",
    "write_view",
]
