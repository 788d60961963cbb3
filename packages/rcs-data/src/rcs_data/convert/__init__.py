"""Exports datasets to the formats of other programs, and imports them."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
