"""`rcs data …`: a file per verb; this is their table."""

from __future__ import annotations

from typing import Annotated

from tyro.conf import subcommand

from rcs.cli.data.check import CheckCommand
from rcs.cli.data.combine import MergeCommand, MixCommand, SplitCommand
from rcs.cli.data.edit import (
    DeleteCommand,
    HistoryCommand,
    KeepCommand,
    PruneCommand,
    RelabelCommand,
    RenameCameraCommand,
    ResampleCommand,
    ResizeCommand,
    TrimCommand,
    UndoCommand,
)
from rcs.cli.data.export import ExportCommand
from rcs.cli.data.import_ import ImportCommand
from rcs.cli.data.info import InfoCommand
from rcs.cli.data.recover import RecoverCommand
from rcs.cli.data.replay import ReplayCommand
from rcs.cli.data.view import ViewCommand

DataCommand = (
    Annotated[InfoCommand, subcommand("info")]
    | Annotated[CheckCommand, subcommand("check")]
    | Annotated[RecoverCommand, subcommand("recover")]
    | Annotated[DeleteCommand, subcommand("delete")]
    | Annotated[KeepCommand, subcommand("keep")]
    | Annotated[TrimCommand, subcommand("trim")]
    | Annotated[RelabelCommand, subcommand("relabel")]
    | Annotated[RenameCameraCommand, subcommand("rename-camera")]
    | Annotated[ResampleCommand, subcommand("resample")]
    | Annotated[ResizeCommand, subcommand("resize")]
    | Annotated[UndoCommand, subcommand("undo")]
    | Annotated[HistoryCommand, subcommand("history")]
    | Annotated[PruneCommand, subcommand("prune")]
    | Annotated[SplitCommand, subcommand("split")]
    | Annotated[MergeCommand, subcommand("merge")]
    | Annotated[MixCommand, subcommand("mix")]
    | Annotated[ReplayCommand, subcommand("replay")]
    | Annotated[ViewCommand, subcommand("view")]
    | Annotated[ExportCommand, subcommand("export")]
    | Annotated[ImportCommand, subcommand("import")]
)
