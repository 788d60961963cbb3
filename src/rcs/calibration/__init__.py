"""Calibration: how a camera sees, where it is, and whether both are still so."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
