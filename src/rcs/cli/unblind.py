"""`rcs unblind`: who X and Y were."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from rcs_data.cli.console import plain_console
from rcs_data.ledger import Ledger, write_ledger_page


@dataclass(kw_only=True)
class UnblindCommand:
    """Say who X and Y were in the blind comparisons of a ledger, on its pages too, from now on."""

    ledger: tyro.conf.Positional[Path]
    """Folder of the ledger, as `rcs run --blind` has made it."""

    def run(self) -> int:
        """Reveal the names, write the page, and return the exit code."""
        console = plain_console(soft_wrap=False)
        with Ledger(self.ledger) as ledger:
            for blind, true in ledger.unblind():
                console.print(f"{blind.agent} ({blind.hash}): {true.agent}, weights {true.weights or 'unknown'}")
            console.print(f"Report: {write_ledger_page(ledger)}", soft_wrap=True)
        return 0
