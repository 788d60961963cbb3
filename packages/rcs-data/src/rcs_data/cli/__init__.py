"""The command line of datasets: each verb has a file; this is their table."""

from __future__ import annotations

from rcs_data.cli.program import Table

VERBS: Table = {
    "info": "rcs_data.cli.view:InfoCommand",
    "check": "rcs_data.cli.check:CheckCommand",
    "recover": "rcs_data.cli.check:RecoverCommand",
    "delete": "rcs_data.cli.edit:DeleteCommand",
    "keep": "rcs_data.cli.edit:KeepCommand",
    "trim": "rcs_data.cli.edit:TrimCommand",
    "relabel": "rcs_data.cli.edit:RelabelCommand",
    "rename-camera": "rcs_data.cli.edit:RenameCameraCommand",
    "resample": "rcs_data.cli.edit:ResampleCommand",
    "resize": "rcs_data.cli.edit:ResizeCommand",
    "undo": "rcs_data.cli.edit:UndoCommand",
    "history": "rcs_data.cli.edit:HistoryCommand",
    "prune": "rcs_data.cli.edit:PruneCommand",
    "split": "rcs_data.cli.combine:SplitCommand",
    "merge": "rcs_data.cli.combine:MergeCommand",
    "mix": "rcs_data.cli.combine:MixCommand",
    "view": "rcs_data.cli.view:ViewCommand",
    "export": "rcs_data.cli.convert:ExportCommand",
    "import": "rcs_data.cli.convert:ImportCommand",
    "pull": "rcs_data.cli.convert:PullCommand",
    "push": "rcs_data.cli.convert:PushCommand",
    "recipe": "rcs_data.cli.convert:RecipeCommand",
}
