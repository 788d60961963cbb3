"""Finds damage, doubtful rows and missing labels in a dataset, and repairs what it can."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
