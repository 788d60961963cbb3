"""Pages to look at a dataset with, in a browser and without a network."""

from __future__ import annotations

from rcs_data.view.clips import ClipOptions, Codec
from rcs_data.view.html import picture_tag, pictures_page
from rcs_data.view.page import VIEW_FOLDER, ViewReport, write_view
from rcs_data.view.report import write_report
from rcs_data.view.sample import SampleReport, write_sample

__all__ = [
    "VIEW_FOLDER",
    "ClipOptions",
    "Codec",
    "SampleReport",
    "ViewReport",
    "picture_tag",
    "pictures_page",
    "write_report",
    "write_sample",
    "write_view",
]
