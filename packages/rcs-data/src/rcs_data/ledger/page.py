"""The page about a ledger: success of every agent, what failed, films, comparisons, and every episode."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rcs_data.files.durable import disk_errors, write_file
from rcs_data.ledger.compare import Comparison, compare, labels_of, verdicts_of
from rcs_data.ledger.condition import Condition
from rcs_data.ledger.groups import STEPS, Group, groups_of
from rcs_data.ledger.ledger import FILMS_FOLDER, Ledger
from rcs_data.ledger.row import Row
from rcs_data.read.verdicts import Verdicts
from rcs_data.view.charts import CHARTS_SCRIPT, Series, chart
from rcs_data.view.html import Html, element, figure, film, header, page, script, table, web

REPORT = "report.html"
_MOST_ROWS = 1000
"""Episodes of a condition that the page lists; `ledger.jsonl` has all."""
_MOST_COMPARED = 12
"""Agents that are compared on the page; `rcs compare` compares any."""
_HEADS = ("episode", "seed", "verdict", "failure", "stages", "tags", "steps", "reward", "latency p50, p99 [ms]")


def write_ledger_page(ledger: Ledger) -> Path:
    """Write `report.html` into a ledger's folder, and return its path.

    Raises:
        DatasetError: The page cannot be written.
        CorruptEpisode: The description of a condition is damaged.
    """
    path = ledger.folder / REPORT
    with disk_errors("write the report", path):
        draft = path.with_name(f".{path.name}.{os.getpid()}")  # several processes may write it at a time
        write_file(draft, _page(ledger).encode())
        draft.replace(path)
    return path


def _page(ledger: Ledger) -> str:
    conditions = ledger.conditions
    labels = labels_of(ledger, list(conditions))
    title = ", ".join(dict.fromkeys(f"{one.task} on {one.robot}" for one in conditions.values())) or "No episode yet"
    damage = [element("p", sentence) for sentence in ledger.damage]
    compared = compare(ledger) if 2 <= len(conditions) <= _MOST_COMPARED else []
    compared = [one for one in compared if one.pairs.n]
    comparison = comparison_table(compared) if compared else None
    if len(conditions) > _MOST_COMPARED:
        words = f"There are too many agents to compare each with each here: rcs compare {ledger.folder} A B"
        comparison = element("section", element("h2", "Comparison"), element("p", words))
    sections = [_section(ledger, hash_, one, labels[hash_]) for hash_, one in conditions.items()]
    parts = [*damage, _curve(ledger, conditions), comparison, *sections]
    main = element("main", *parts, class_="sheet")
    return page(title, header(title), main, script(web(CHARTS_SCRIPT)))


def _curve(ledger: Ledger, conditions: Mapping[str, Condition]) -> Html | None:
    """Return success over steps of training, a line per run; None where no run has several checkpoints."""
    if all(one.trained is None for one in conditions.values()):
        return None
    runs: dict[str, list[Group]] = {}
    for one in groups_of(ledger, STEPS, ["policy"]):
        if one.verdicts.judged:
            runs.setdefault(one.series, []).append(one)
    lines = [
        Series(
            name=run,
            x=[one.value for one in points],
            y=[100 * (one.verdicts.rate or 0.0) for one in points],
            low=[100 * one.verdicts.interval[0] for one in points],
            high=[100 * one.verdicts.interval[1] for one in points],
            told=[str(one.verdicts) for one in points],
            colour=number,
        )
        for number, (run, points) in enumerate(runs.items())
        if len(points) > 1
    ]
    if not lines:
        return None
    most = max(line.x[-1] for line in lines)
    title = "Success [%] over steps of training, 95 % Wilson interval"
    return element("section", chart(title, lines, most=max(most, 1), span=(0, 100), width=1000))


def comparison_page(ledger: Ledger, compared: Sequence[Comparison]) -> str:
    """Return a page about comparisons: the rate of each agent within its interval, and what pairs of seeds show."""
    rates = {name: one for each in compared for name, one in zip((each.a, each.b), each.verdicts, strict=True)}
    sections = [
        element("section", element("h2", name), element("p", str(one)), None if one.rate is None else _bar(one))
        for name, one in rates.items()
    ]
    title = f"{ledger.folder.resolve().name}: {', '.join(rates)}"
    return page(title, header(title), element("main", comparison_table(compared), *sections, class_="sheet"))


def comparison_table(compared: Sequence[Comparison]) -> Html:
    """Return comparisons as a section."""
    rows = [
        (_line(one.a), _line(one.b), one.pairs.n, one.pairs.only_a, one.pairs.only_b, one.pairs.left_out, one.words)
        for one in compared
    ]
    heads = ("A", "B", "shared seeds", "A alone", "B alone", "left out", "in words")
    holm = "; p values are adjusted for their number by Holm's method" if len(compared) > 1 else ""
    words = element(
        "p",
        f"Pairs of episodes with the same seed, McNemar's exact test{holm}. The p value, p, holds where the number of "
        "episodes was chosen beforehand. After an early end (--until), or looks in between, it is too small; the e "
        f"value, e, holds at every look, and {len(compared) * 20} or more shows a difference at a level of 5 %.",
    )
    others = {name for one in compared for name in one.differences}
    other = f"The agents were not evaluated alike: {', '.join(sorted(others))} differ." if others else None
    return element("section", element("h2", "Comparison"), words, table(rows, heads), other and element("p", other))


def _line(name: str) -> Html:
    """Return a name that stays on one line."""
    return element("span", name, style="white-space:nowrap")


def _section(ledger: Ledger, hash_: str, condition: Condition, label: str) -> Html:
    rows = sorted(ledger.of(hash_), key=lambda row: row.seed)
    filmed = [row for row in ledger.rows.values() if row.condition == hash_ and ledger.film(row).is_file()]
    films = (figure(film(f"{FILMS_FOLDER}/{row.name}.mp4"), f"seed {row.seed}: {_verdict(row)}") for row in filmed)
    failures = Counter(row.failure for row in rows if row.failure is not None)
    text = ", ".join(f"{name} {count}" for name, count in failures.most_common()) or "none"
    verdicts = verdicts_of(rows)
    repeated = [row for row in ledger.rows.values() if row.condition == hash_ and row.repeat]
    other = sum(row.success != ledger.rows[row.key].success for row in repeated if row.key in ledger.rows)
    listed = table([_cells(row, number) for number, row in enumerate(rows[:_MOST_ROWS])], _HEADS)
    return element(
        "section",
        element("h2", label),
        element("p", element("b", str(verdicts)), f"; {verdicts.not_judged} not judged. Failures: {text}."),
        None if verdicts.rate is None else _bar(verdicts),
        _stages(rows),
        element("p", f"{other} of {len(repeated)} repeated episodes ended differently.") if repeated else None,
        table(_about(ledger, hash_, condition)),
        element("div", *films, class_="films"),
        element("details", element("summary", f"{len(rows)} episodes"), listed),
    )


def _stages(rows: Sequence[Row]) -> Html | None:
    """Return in how many episodes each stage of the task was reached; None if nobody counted."""
    counted = [row.stages for row in rows if row.stages is not None]
    if not counted:
        return None
    text = ", ".join(f"{stage} in {sum(one >= stage for one in counted)}" for stage in range(1, max(counted) + 1))
    return element("p", f"Stages reached, of {len(counted)} episodes that were counted: {text or 'none'}.")


def _about(ledger: Ledger, hash_: str, condition: Condition) -> list[tuple[str, Any]]:
    setup, policy = condition.setup, condition.policy
    about = {
        "Condition": hash_,
        "Agent": ledger.place(hash_) or condition.agent,
        "Weights": condition.weights or "none, or unknown",
        "Steps of training": condition.trained,
        "Training data": condition.data,
        "Action": ", ".join(f"{part['name']} {part['meaning']}" for part in policy.get("action", ())),
        "Rows of a chunk": policy.get("horizon"),
        "Execution": ", ".join(f"{name} {value}" for name, value in condition.execution.items() if value is not None),
        "Loop": f"{setup.get('frequency', '?')} Hz, stepping {setup.get('stepping', '?')}",
        "Real": ", ".join(f"{name} by {driver}" for name, driver in condition.platform.items()),
        "Tags": ", ".join(f"{name} {value}" for name, value in condition.tags.items()),
    }
    return [(name, value) for name, value in about.items() if value]


def _bar(verdicts: Verdicts) -> Html:
    """Return a rate within its interval."""
    low, high = (100 * bound for bound in verdicts.interval)
    interval = element("i", style=f"left:{low:.2f}%;width:{high - low:.2f}%")
    return element("div", interval, element("b", style=f"left:{100 * (verdicts.rate or 0.0):.2f}%"), class_="bar")


def _cells(row: Row, number: int) -> tuple[object, ...]:
    failure = ": ".join(part for part in (row.failure, row.message) if part is not None)
    latency = (row.latency_p50, row.latency_p99)
    text = ", ".join(f"{1000 * value:.1f}" for value in latency if value is not None)
    reward = "" if row.reward is None else f"{row.reward:.2f}"
    stages = "" if row.stages is None else row.stages
    return number, row.seed, _verdict(row), failure, stages, ", ".join(row.tags), row.steps, reward, text


def _verdict(row: Row) -> str:
    return "not judged" if row.success is None else "success" if row.success else "failure"
