"""Comparisons of agents in a ledger, as figures and in words: pairs of episodes with the same seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

from rcs_data.errors import InvalidSetup
from rcs_data.ledger.comparison import FEWEST, Pairs, holm
from rcs_data.ledger.condition import Condition
from rcs_data.ledger.ledger import Ledger
from rcs_data.ledger.row import Row
from rcs_data.read.verdicts import Verdicts

LEVEL = 0.05
"""Probability with which equal agents are found different."""
_OWN = ("agent", "weights", "trained", "data", "policy", "execution", "tags")
"""Fields of a condition in which two agents may differ: everything else should be the same."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Two agents on the same seeds."""

    a: str
    """Name of the first agent, with its hash where names are the same."""
    b: str
    """Name of the second."""
    verdicts: tuple[Verdicts, Verdicts]
    """All episodes of each."""
    pairs: Pairs
    """Episodes with the same seed."""
    p: float
    """The p value of the pairs; of several comparisons, adjusted by Holm's method."""
    level: float = LEVEL
    """Largest p value of the pairs that shows a difference whatever the other comparisons give: `LEVEL` over their
    number."""
    until: float | None = None
    """Level of an evaluation that looked after every pair, so that its e value decides; None if the p value does."""
    differences: dict[str, tuple[Any, Any]]
    """Values besides the agents that differ between the two, by name."""

    @property
    def winner(self) -> str | None:
        """Name of the better agent; None if none is shown to be."""
        pairs = self.pairs
        by_p = pairs.discordant >= FEWEST and self.p <= LEVEL
        if not (by_p if self.until is None else pairs.is_decided(self.until)):
            return None
        return self.a if pairs.only_a > pairs.only_b else self.b

    @property
    def words(self) -> str:
        """The result in a sentence or two."""
        pairs = self.pairs
        if not pairs.n:
            return f"Not comparable: {self.a} and {self.b} share no seed on which both were judged."
        low, high = (100 * bound for bound in pairs.interval)
        difference = 100 * (pairs.difference or 0.0)
        where = f"on {pairs.n} shared seeds"
        size = f"{difference:+.1f} points, 95 % interval {low:+.1f} to {high:+.1f}"
        if self.until is None:
            size += f", p = {self.p:.2g}, e = {pairs.evidence:.2g}"
        else:
            size += f", looking after every pair: e = {pairs.evidence:.3g}, of {1 / self.until:.3g} that are needed"
        if (winner := self.winner) is not None:
            return f"{winner} is better than {self.b if winner == self.a else self.a} {where} ({size})."
        text = f"Not shown that {self.a} and {self.b} differ {where} ({size})."
        if pairs.discordant < FEWEST:
            text += f" They ended differently on {pairs.discordant} of them, and fewer than {FEWEST} give no verdict."
        if self.until is None and (needed := pairs.needed(self.level)) is not None:
            text += f" About {max(needed, pairs.n + 1)} shared seeds would show a difference of this size."
        return text


def compare(ledger: Ledger, names: Sequence[str] = ()) -> list[Comparison]:
    """Compare every two agents of a ledger.

    Args:
        ledger: The ledger.
        names: Names of the agents or starts of their conditions' hashes, at least two. None for every two of the same
            task and robot that both are real, or both simulated: others would say nothing about the agents.

    Raises:
        InvalidSetup: There is no such agent, or there are fewer than two.
        CorruptEpisode: The description of a condition is damaged.
    """
    hashes = list(dict.fromkeys(ledger.find(name) for name in names)) if names else list(ledger.conditions)
    if len(hashes) < 2:
        raise InvalidSetup(f"{len(hashes)} agent in {ledger.folder} to compare; name two, or evaluate another.")
    labels = labels_of(ledger, hashes)
    rows = {one: ledger.of(one) for one in hashes}
    found = [
        _compared(labels[a], labels[b], rows[a], rows[b], ledger.condition(a), ledger.condition(b))
        for a, b in combinations(hashes, 2)
        if names or _place_of(ledger.condition(a)) == _place_of(ledger.condition(b))
    ]
    # Those that share no seed test nothing, so they make no verdict harder.
    p_values = [one.p for one in found if one.pairs.n]
    adjusted, level = iter(holm(p_values)), LEVEL / max(len(p_values), 1)
    return [replace(one, p=next(adjusted), level=level) if one.pairs.n else one for one in found]


def labels_of(ledger: Ledger, hashes: Sequence[str]) -> dict[str, str]:
    """Return the names of the agents of conditions, with the hash where a name is not enough."""
    names = {one: ledger.condition(one).agent for one in hashes}
    return {
        one: name if list(names.values()).count(name) == 1 else f"{name} ({one[:6]})" for one, name in names.items()
    }


def verdicts_of(rows: Sequence[Row]) -> Verdicts:
    """Count the verdicts of rows."""
    return Verdicts.of(row.success for row in rows)


def _place_of(condition: Condition) -> tuple[str, str, bool]:
    """Return what agents have in common that are compared unasked."""
    return condition.task, condition.robot, condition.is_real


def _compared(
    a: str, b: str, rows_a: Sequence[Row], rows_b: Sequence[Row], one: Condition, other: Condition
) -> Comparison:
    pairs = Pairs.of(*({row.seed: row.success for row in rows} for rows in (rows_a, rows_b)))
    # A module or package that one agent alone has is its own.
    found = {
        name: (ours, theirs)
        for name, (ours, theirs) in one.differences(other).items()
        if name.partition(".")[0] not in _OWN
        and not (name.startswith(("code.", "versions.")) and None in (ours, theirs))
    }
    return Comparison(
        a=a,
        b=b,
        verdicts=(verdicts_of(rows_a), verdicts_of(rows_b)),
        pairs=pairs,
        p=pairs.p,
        differences=found,
    )
