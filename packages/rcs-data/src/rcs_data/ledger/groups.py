"""Success rates of a ledger by robot, policy, steps of training, or whatever else its conditions differ in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rcs_data.errors import InvalidSetup, UnknownName
from rcs_data.ledger.compare import verdicts_of
from rcs_data.ledger.comparison import mean_maximum_rank_violation, pearson
from rcs_data.ledger.condition import Condition, leaves
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
"""What rates are grouped by: the agent's name without its steps, its whole name, and so on. Tags are keys, too."""
_NAMED = ("policy", "task", "robot", "domain")
_CHECKPOINT: Mapping[str, Callable[[Any], str]] = {
    STEPS: lambda value: f"{value} steps",
    "agent": str,
    "weights": lambda value: f"weights {value[:16]}",
}
"""What tells the checkpoints of a policy apart, from the plainest on, and how a series is named by it."""


@dataclass(frozen=True, kw_only=True)
class Group:
    """Episodes that have a value of the key, and are alike in what else a line or a colour stands for."""

    series: str
    """What line or colour they belong to; empty if there is one."""
    value: Any
    """The value of the key."""
    verdicts: Verdicts
    """Their verdicts."""


def groups_of(ledger: Ledger, by: str) -> list[Group]:
    """Return rates by a key, in the order of its values, and then of series.

    Different checkpoints of a policy are never in one rate: those that would be are series of their own.

    Args:
        ledger: The ledger.
        by: One of `KEYS`, a tag, or a path in a condition, such as `setup.frequency` or `execution.mode`.

    Raises:
        InvalidSetup: No condition has such a value; the message has the keys that there are.
        CorruptEpisode: The description of a condition is damaged.
    """
    conditions = [one for one in ledger.conditions.items() if _value(one[1], by) is not None]
    if not conditions:
        every = list(ledger.conditions.values())
        tags = {name for one in every for name in one.tags}
        differ = {name for one in every for name in every[0].differences(one)}
        raise InvalidSetup(UnknownName(f"key in {ledger.folder}", by, {*KEYS, *tags, *differ}).message)
    tags = sorted({name for _, one in conditions for name in one.tags})
    names = [
        name
        for name in (*_NAMED, *tags)
        if name != by
        and not (by == "agent" and name == "policy")
        and len({_value(one, name) for _, one in conditions}) > 1
    ]
    for name in _CHECKPOINT:
        if len(_distinct(conditions, [by, *names, name])) > len(_distinct(conditions, [by, *names])):
            names.append(name)
    rows: dict[tuple[str, Any], list[Any]] = {}
    for hash_, one in conditions:
        named = {name: value for name in names if (value := _value(one, name)) is not None}
        series = ", ".join(_CHECKPOINT.get(name, str)(value) for name, value in named.items())
        rows.setdefault((series, _value(one, by)), []).extend(ledger.of(hash_))
    found = [Group(series=series, value=value, verdicts=verdicts_of(own)) for (series, value), own in rows.items()]
    is_number = all(isinstance(one.value, int | float) for one in found)
    return sorted(found, key=lambda one: one.value) if is_number else found


def domains_in_words(ledger: Ledger) -> str | None:
    """Return how simulation and reality agree on the policies that have rates in both; None for fewer than two.

    Raises:
        CorruptEpisode: The description of a condition is damaged.
    """
    rates: dict[tuple[Any, Any, Any], dict[bool, list[Any]]] = {}
    for hash_, one in ledger.conditions.items():
        rates.setdefault((one.agent, one.task, one.robot), {}).setdefault(one.is_real, []).extend(ledger.of(hash_))
    pairs = [
        (real, simulated)
        for both in rates.values()
        if (real := _rate(both.get(True, []))) is not None and (simulated := _rate(both.get(False, []))) is not None
    ]
    if len(pairs) < 2:
        return None
    real, simulated = ([pair[i] for pair in pairs] for i in (0, 1))
    correlation = pearson(real, simulated)
    told = "none, as one of the two does not vary" if correlation is None else f"{correlation:.2f}"
    violation = mean_maximum_rank_violation(real, simulated)
    return (
        f"Simulation and reality, {len(pairs)} agents with rates in both: Pearson's correlation {told}, mean maximum "
        f"rank violation {violation:.2f}."
    )


def _distinct(conditions: Sequence[tuple[str, Condition]], keys: Sequence[str]) -> set[tuple[Any, ...]]:
    return {tuple(_value(one, key) for key in keys) for _, one in conditions}


def _rate(rows: Sequence[Any]) -> float | None:
    return verdicts_of(rows).rate


def _value(condition: Condition, key: str) -> Any:
    if key in KEYS:
        return KEYS[key](condition)
    return condition.tags.get(key, leaves(condition.to_json()).get(key))
