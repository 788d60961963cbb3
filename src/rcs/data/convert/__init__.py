"""Datasets as other programs have them: export to their layouts, and import from them."""

from rcs.lazy import load_on_use

load_on_use(__name__)
