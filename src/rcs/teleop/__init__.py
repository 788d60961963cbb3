"""Teleoperation: people lead robots by devices in their hands."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
