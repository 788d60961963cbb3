"""Observers: they see every step and change nothing (the paper's identity wrappers)."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
