"""`rcs figures`: success rates in a ledger with their intervals, drawn."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from rcs_data.cli.console import plain_console
from rcs_data.ledger import Ledger
from rcs_data.ledger.figures import write_figures


@dataclass(kw_only=True)
class FiguresCommand:
    """Draw success rates in a ledger with their 95 % intervals, as SVG, PNG and a page (extra `figures`)."""

    ledger: tyro.conf.Positional[Path]
    """Folder of the ledger, as `rcs eval --out` has it."""
    by: str = "policy"
    """Key that rates are grouped by: `policy`, `agent`, `task`, `robot`, `domain` (real or simulation), `steps` of
    training, a tag such as `mix`, or a path in a condition, such as `setup.frequency` or `execution.mode`. Numbers
    become curves, everything else bars; what else differs, checkpoints among it, is a colour each."""

    def run(self) -> int:
        """Draw, say where the files are, and return the exit code."""
        console = plain_console(soft_wrap=False)
        with Ledger(self.ledger) as ledger:
            path = write_figures(ledger, self.by)
            for sentence in ledger.damage:
                console.print(sentence, soft_wrap=True)
        console.print(f"Figures: {path.with_suffix('.svg')}, {path.with_suffix('.png')}", soft_wrap=True)
        console.print(f"Page: {path}", soft_wrap=True)
        return 0
