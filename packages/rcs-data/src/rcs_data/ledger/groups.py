"""Success rates of a ledger by robot, policy, steps of training, or whatever else its conditions differ in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rcs_data.errors import InvalidSetup, UnknownName
from rcs_data.files.json_file import leaves
from rcs_data.ledger.compare import verdicts_of
from rcs_data.ledger.comparison import mean_maximum_rank_violation, pearson
from rcs_data.ledger.condition import BLIND, Condition
from rcs_data.ledger.ledger import Ledger
from rcs_data.read.verdicts import Verdicts

STEPS = "steps"
KEYS: Mapping[str, Callable[[Condition], Any]] = {
    "policy": lambda one: one.agent.partition("@")[0],
    "agent": lambda one: one.agent,
    "task": lambda one: one.task,
    "robot": lambda one: one.robot,
    "domain": lambda one: "real" if one.is_real else "simulation",
    STEPS: lambda one: one.trained,
}
"""Keys that rates are grouped by: the agent's name without its steps, its whole name, and so on. Tags are keys, too."""
_NAMED = ("policy", "task", "robot", "domain")
_SHA256, _DIGITS = 64, 16
"""Digits of a hash, and of one in the name of a series."""


@dataclass(frozen=True, kw_only=True)
class Group:
    """Episodes that have a value of the key, and are alike in what else a line or a colour stands for."""

    series: str
    """The line or colour that they belong to; empty if there is one."""
    value: Any
    """The value of the key."""
    verdicts: Verdicts
    """Their verdicts."""


def groups_of(ledger: Ledger, by: str, names: Sequence[str] | None = None) -> list[Group]:
    """Return rates by a key, in the order of its values, and then of series.

    Different conditions are never in one rate, which would count their common seeds several times: those that would be
    are series of their own, by what they differ in.

    Args:
        ledger: The ledger.
        by: One of `KEYS`, a tag, or a path in a condition, such as `setup.frequency` or `execution.mode`.
        names: Keys by which series are named in any case; None for policy, task, robot, domain and tags that differ.

    Raises:
        InvalidSetup: No condition has such a value; the message has the keys that there are.
        CorruptEpisode: The description of a condition is damaged.
    """
    conditions = ledger.conditions
    own = {hash_: values for hash_, one in conditions.items() if (values := _values(one)).get(by) is not None}
    if not own:
        every = list(conditions.values())
        tags = {name for one in every for name in one.tags}
        differ = {name for one in every for name in every[0].differences(one)}
        raise InvalidSetup(UnknownName(f"key in {ledger.folder}", by, {*KEYS, *tags, *differ}).message)
    tags = sorted({name for hash_ in own for name in conditions[hash_].tags})
    if names is None:
        plain = [name for name in (*_NAMED, *tags) if name not in (by, BLIND) and (by, name) != ("agent", "policy")]
        names = [name for name in plain if len({values.get(name) for values in own.values()}) > 1]

    def count(keys: Sequence[str]) -> int:
        return len({(_series(values, keys, tags), values[by]) for values in own.values()})

    more = [name for values in own.values() for name in values]
    for name in dict.fromkeys((*_NAMED, *tags, STEPS, "agent", "weights", *more)):
        if count([*names, name]) > count(names):
            names = [*names, name]
    found = [
        Group(series=_series(values, names, tags), value=values[by], verdicts=verdicts_of(ledger.of(hash_)))
        for hash_, values in own.items()
    ]
    is_number = all(isinstance(one.value, int | float) for one in found)
    return sorted(found, key=lambda one: one.value) if is_number else found


def domains_in_words(ledger: Ledger) -> str | None:
    """Return how simulation and reality agree on the policies that have rates in both; None for fewer than two.

    Raises:
        CorruptEpisode: The description of a condition is damaged.
    """
    rates: dict[str, dict[str, float]] = {}
    for one in groups_of(ledger, "domain", ["agent", "task", "robot"]):
        if one.verdicts.rate is not None:
            rates.setdefault(one.series, {})[one.value] = one.verdicts.rate
    pairs = [(both["real"], both["simulation"]) for both in rates.values() if len(both) == 2]
    if len(pairs) < 2:
        return None
    real, simulated = ([pair[i] for pair in pairs] for i in (0, 1))
    correlation = pearson(real, simulated)
    text = "none, as one of the two does not vary" if correlation is None else f"{correlation:.2f}"
    violation = mean_maximum_rank_violation(real, simulated)
    return (
        f"Simulation and reality, {len(pairs)} agents with rates in both: Pearson's correlation {text}, mean maximum "
        f"rank violation {violation:.2f}."
    )


def _series(values: Mapping[str, Any], names: Sequence[str], tags: Sequence[str]) -> str:
    """Return the name of a series: plain values of keys and tags, others with their paths."""
    words: list[str] = []
    for name in names:
        text = "none" if values.get(name) is None else str(values[name])
        if name not in (*KEYS, *tags):
            words.append(f"{name} {text[:_DIGITS] if len(text) == _SHA256 else text}")
        elif values.get(name) is not None:
            words.append(f"{text} {name}" if name == STEPS else text)
    return ", ".join(words)


def _values(condition: Condition) -> dict[str, Any]:
    """Return the values of a condition by key; lists, true and false are texts, and nothing is empty."""
    found = leaves(condition.to_json()) | dict(condition.tags) | {key: get(condition) for key, get in KEYS.items()}
    return {
        name: value if isinstance(value, int | float | str | None) and not isinstance(value, bool) else str(value)
        for name, value in found.items()
        if value != {}
    }
