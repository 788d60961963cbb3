"""Layers: pure maps between the actions and observations of two levels of an environment."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
