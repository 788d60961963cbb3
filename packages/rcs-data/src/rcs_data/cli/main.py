"""The entry point of the command `rcs-data`."""

from __future__ import annotations

import sys
from importlib.metadata import version

from rcs_data.cli import VERBS
from rcs_data.cli.program import Program


def main() -> None:
    """Run a command and exit: 0 for success, 1 for an error or bad finding, 2 if invalid, 130 if interrupted."""
    Program("rcs-data", VERBS, version("rcs-data")).main(sys.argv[1:])
