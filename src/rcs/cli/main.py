"""The entry point of the command `rcs`."""

from __future__ import annotations

import sys

from rcs_data.cli import VERBS as OF_DATASETS
from rcs_data.cli.program import Program, Table

VERBS: Table = {
    "collect": "rcs.cli.collect:CollectCommand",
    "train": "rcs.cli.train:TrainCommand",
    "eval": "rcs.cli.eval:EvalCommand",
    "run": "rcs.cli.run:RunCommand",
    "unblind": "rcs.cli.ledger:UnblindCommand",
    "sweep": "rcs.cli.sweep:SweepCommand",
    "compare": "rcs.cli.ledger:CompareCommand",
    "figures": "rcs.cli.ledger:FiguresCommand",
    "data": "rcs.cli.data:VERBS",
    "calibrate": "rcs.cli.calibrate:VERBS",
    "sim": "rcs.cli.sim:SimCommand",
    "teleop": "rcs.cli.teleop:TeleopCommand",
    "home": "rcs.cli.home:HomeCommand",
    "virtual": "rcs.cli.virtual:VirtualCommand",
    "list": "rcs.cli.list:ListCommand",
    "host": "rcs.cli.host:HostCommand",
    "stop": "rcs.cli.host:StopCommand",
    "doctor": "rcs.cli.doctor:DoctorCommand",
}


def main(arguments: list[str] | None = None) -> None:
    """Run a command and exit: 0 for success, 1 for an error or bad finding, 2 if invalid, 130 if interrupted."""
    from rcs.version import __version__

    in_data = {verb: f"rcs data {verb}" for verb in (*OF_DATASETS, "replay")}
    Program("rcs", VERBS, __version__, in_data).main(sys.argv[1:] if arguments is None else arguments)
