"""The command line of datasets: each verb has a file; this is their table."""

from __future__ import annotations

from rcs_data.cli.verbs import Table

VERBS: Table = {
    "info": "rcs_data.cli.info:InfoCommand",
    "check": "rcs_data.cli.check:CheckCommand",
    "recover": "rcs_data.cli.recover:RecoverCommand",
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
    "sample": "rcs_data.cli.sample:SampleCommand",
    "export": "rcs_data.cli.export:ExportCommand",
    "import": "rcs_data.cli.import_:ImportCommand",
    "pull": "rcs_data.cli.hub:PullCommand",
    "push": "rcs_data.cli.hub:PushCommand",
    "recipe": "rcs_data.cli.recipe:RecipeCommand",
}
