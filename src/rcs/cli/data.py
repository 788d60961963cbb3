"""Inspect, check, repair, edit, mix, replay, convert and view datasets."""

from __future__ import annotations

from rcs_data.cli import VERBS as OF_DATASETS
from rcs_data.cli.program import Table

VERBS: Table = {**OF_DATASETS, "replay": "rcs.cli.replay:ReplayCommand"}
"""The verbs of `rcs-data`, and those that need a simulation."""
