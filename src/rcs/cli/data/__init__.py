"""`rcs data …`: a file per verb; this is their table."""

from __future__ import annotations

from typing import Annotated

from tyro.conf import subcommand

from rcs.cli.data.check import CheckCommand
from rcs.cli.data.info import InfoCommand
from rcs.cli.data.recover import RecoverCommand
from rcs.cli.data.replay import ReplayCommand

DataCommand = (
    Annotated[InfoCommand, subcommand("info")]
    | Annotated[CheckCommand, subcommand("check")]
    | Annotated[RecoverCommand, subcommand("recover")]
    | Annotated[ReplayCommand, subcommand("replay")]
)
