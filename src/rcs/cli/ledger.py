"""`rcs unblind`, `rcs compare` and `rcs figures`: what a ledger says."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rcs_data.cli.console import plain_console
from rcs_data.files.durable import disk_errors, write_file
from rcs_data.ledger import Ledger, write_ledger_page
from rcs_data.ledger.compare import compare, labels_of, verdicts_of
from rcs_data.ledger.figures import write_figures
from rcs_data.ledger.page import comparison_page
from rich.table import Table


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


@dataclass(kw_only=True)
class CompareCommand:
    """Compare agents in a ledger by their episodes with the same seeds, and say which is better.

    Episodes with the same seed have the same start, so they form pairs; only pairs that ended differently say which
    agent is better (McNemar's exact test; p values of several comparisons are adjusted by Holm's method). Episodes
    without a verdict are left out, and counted.
    """

    ledger: tyro.conf.Positional[Path]
    """Folder of the ledger, as `rcs eval --out` has it."""
    agents: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[AGENT ...]")] = ()
    """Names of agents, or starts of the hashes of their conditions; none for every two in the ledger that have task,
    robot and domain (real or simulation) in common."""
    page: Path | None = None
    """File of the page; by default `comparison.html` in the ledger's folder."""

    def run(self) -> int:
        """Print rates and comparisons, write the page, and return the exit code."""
        console = plain_console(soft_wrap=False)
        with Ledger(self.ledger) as ledger:
            compared = compare(ledger, self.agents)
            hashes = [ledger.find(name) for name in self.agents] if self.agents else list(ledger.conditions)
            labels = labels_of(ledger, hashes)
            table = Table("agent", "success", "not judged", "condition", box=None, pad_edge=False)
            for one in dict.fromkeys(hashes):
                verdicts = verdicts_of(ledger.of(one))
                table.add_row(labels[one], str(verdicts), str(verdicts.not_judged), one)
            console.print(table)
            for one in compared:
                console.print(one.words, soft_wrap=True)
                if one.differences:
                    console.print(f"They were not evaluated alike: {_differences(one.differences)}.", soft_wrap=True)
            for sentence in ledger.damage:
                console.print(sentence, soft_wrap=True)
            if not compared:
                console.print("No two of them have task, robot and domain in common: name agents to compare them.")
                return 0
            path = self.page or self.ledger / "comparison.html"
            with disk_errors("write the page", path):
                write_file(path, comparison_page(ledger, compared).encode())
            console.print(f"Page: {path}", soft_wrap=True)
        return 0


def _differences(differences: dict[str, tuple[object, object]]) -> str:
    return "; ".join(f"{name} is {ours} and {theirs}" for name, (ours, theirs) in differences.items())


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
