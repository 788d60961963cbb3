"""Inspect, check, repair, edit, mix, replay, convert and view datasets.

Each verb has a file; this is their table.
"""

from __future__ import annotations

from rcs.cli.verbs import Table

VERBS: Table = {
    "info": "rcs.cli.data.info:InfoCommand",
    "check": "rcs.cli.data.check:CheckCommand",
    "recover": "rcs.cli.data.recover:RecoverCommand",
    "delete": "rcs.cli.data.edit:DeleteCommand",
    "keep": "rcs.cli.data.edit:KeepCommand",
    "trim": "rcs.cli.data.edit:TrimCommand",
    "relabel": "rcs.cli.data.edit:RelabelCommand",
    "rename-camera": "rcs.cli.data.edit:RenameCameraCommand",
    "resample": "rcs.cli.data.edit:ResampleCommand",
    "resize": "rcs.cli.data.edit:ResizeCommand",
    "undo": "rcs.cli.data.edit:UndoCommand",
    "history": "rcs.cli.data.edit:HistoryCommand",
    "prune": "rcs.cli.data.edit:PruneCommand",
    "split": "rcs.cli.data.combine:SplitCommand",
    "merge": "rcs.cli.data.combine:MergeCommand",
    "mix": "rcs.cli.data.combine:MixCommand",
    "replay": "rcs.cli.data.replay:ReplayCommand",
    "view": "rcs.cli.data.view:ViewCommand",
    "export": "rcs.cli.data.export:ExportCommand",
    "import": "rcs.cli.data.import_:ImportCommand",
    "recipe": "rcs.cli.data.recipe:RecipeCommand",
}
