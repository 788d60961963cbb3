"""Teleoperation: people lead robots with input devices."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
