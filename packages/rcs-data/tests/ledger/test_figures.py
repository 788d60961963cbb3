"""Figures group rates by any key, and show intervals; the same ledger makes the same bytes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from rcs_data.errors import InvalidSetup
from rcs_data.ledger import Ledger
from rcs_data.ledger.figures import write_figures
from rcs_data.ledger.groups import domains_in_words, groups_of
from rcs_data.ledger.page import write_ledger_page

if TYPE_CHECKING:
    from conftest import MakeCondition, MakeRow  # pyright: ignore[reportAttributeAccessIssue]


@pytest.fixture
def varied(tmp_path: Path, make_row: MakeRow, make_condition: MakeCondition) -> Ledger:
    """Two runs with two checkpoints each, in simulation and on a robot; later checkpoints are better."""
    ledger = Ledger.open(tmp_path / "varied")
    for run, mix in (("act", "half"), ("pi", "all")):
        for steps in (2000, 1000):
            for platform in ({}, {"fr3": "franka"}):
                frequency = 5.0 if run == "pi" else 30.0
                condition = make_condition(f"{run}@{steps}", trained=steps, tags={"mix": mix}, platform=platform)
                condition = replace(condition, setup={"frequency": frequency})
                ledger.register(condition)
                for seed in range(10):
                    ledger.add(make_row(condition, seed, seed < steps // 250 - (run == "pi") - bool(platform)))
    return ledger


def test_checkpoints_are_a_curve_per_run_and_domain(varied: Ledger) -> None:
    found = groups_of(varied, "steps")
    assert [one.value for one in found] == sorted(one.value for one in found)
    rates = {(one.series, one.value): one.verdicts.succeeded for one in found}
    assert rates[("act, simulation, half", 1000)] == 4
    assert rates[("act, simulation, half", 2000)] == 8
    assert rates[("pi, real, all", 2000)] == 6
    assert len(rates) == 8


def test_the_page_has_a_curve_per_run_and_domain(varied: Ledger) -> None:
    page = write_ledger_page(varied).read_text()
    for name in ("act, simulation", "act, real", "pi, simulation", "pi, real"):
        assert f"</i>{name}</span>" in page, name


def test_the_page_counts_the_episodes_that_reached_each_stage(
    tmp_path: Path, make_row: MakeRow, make_condition: MakeCondition
) -> None:
    ledger = Ledger.open(tmp_path / "staged")
    condition = make_condition("alpha")
    ledger.register(condition)
    for seed, stages in enumerate((0, 1, 3, 3, None)):
        ledger.add(make_row(condition, seed, stages == 3, stages=stages, tags=("slip",) if stages == 1 else ()))
    page = write_ledger_page(ledger).read_text()
    assert "Stages reached, of 4 episodes that were counted: 1 in 3, 2 in 2, 3 in 2." in page
    assert "slip" in page


def test_whatever_differs_is_a_key(varied: Ledger) -> None:
    assert {one.value for one in groups_of(varied, "mix")} == {"half", "all"}
    assert {one.value for one in groups_of(varied, "setup.frequency")} == {5.0, 30.0}
    (simulated, real) = [one for one in groups_of(varied, "domain") if one.series == "act, half, 1000 steps"]
    assert (simulated.value, simulated.verdicts.judged, real.value, real.verdicts.judged) == (
        "simulation",
        10,
        "real",
        10,
    )
    with pytest.raises(InvalidSetup, match=r"'robott'\. Did you mean 'robot'\?"):
        groups_of(varied, "robott")


def test_true_and_false_are_no_numbers(tmp_path: Path, make_row: MakeRow, make_condition: MakeCondition) -> None:
    ledger = Ledger.open(tmp_path / "native")
    for native in (True, False):
        condition = make_condition(setup={"native": native})
        ledger.register(condition)
        ledger.add(make_row(condition, 1))
    assert [one.value for one in groups_of(ledger, "setup.native")] == ["True", "False"]


@pytest.mark.parametrize("by", ["policy", "agent", "robot", "domain", "steps", "mix", "setup.frequency"])
def test_two_checkpoints_are_never_in_one_rate(varied: Ledger, by: str) -> None:
    found = groups_of(varied, by)
    assert [one.verdicts.judged for one in found] == [10] * 8
    assert len({(one.series, one.value) for one in found}) == 8


def test_checkpoints_that_differ_in_their_weights_alone_are_told_apart(
    tmp_path: Path, make_row: MakeRow, make_condition: MakeCondition
) -> None:
    ledger = Ledger.open(tmp_path / "again")
    for weights in ("a" * 64, "b" * 64):
        condition = make_condition("act", trained=1000, weights=weights)
        ledger.register(condition)
        ledger.add(make_row(condition, 0))
    for by in ("policy", "robot", "steps"):
        assert [one.series for one in groups_of(ledger, by)] == [f"weights {name * 16}" for name in "ab"]


@pytest.mark.parametrize(
    ("change", "series"),
    [
        ({"setup": {"frequency": 5.0}}, "setup.frequency 5.0"),
        ({"execution": {"mode": "rtc"}}, "execution.mode rtc"),
        ({"code": {"rcs": "c" * 64}}, f"code.rcs {'c' * 16}"),
        ({"setup": {"frequency": 30.0, "layers": ["KeepTilt"]}}, "setup.layers ['KeepTilt']"),
    ],
)
def test_conditions_that_differ_in_anything_are_series_of_their_own(
    tmp_path: Path, make_row: MakeRow, make_condition: MakeCondition, change: dict[str, Any], series: str
) -> None:
    ledger = Ledger.open(tmp_path / "two")
    both = {"trained": 1000, "code": {"rcs": "a" * 64}}
    for condition in (make_condition("act@1000", **both), make_condition("act@1000", **{**both, **change})):
        ledger.register(condition)
        for seed in range(20):
            ledger.add(make_row(condition, seed, seed % 2 == 0))
    for by in ("policy", "agent", "task", "robot", "domain", "steps"):
        found = groups_of(ledger, by)
        assert [one.verdicts.judged for one in found] == [20, 20], "no seed counts twice"
        assert found[1].series == series


def test_an_agent_is_not_pooled_over_conditions_when_domains_are_compared(varied: Ledger, make_row: MakeRow) -> None:
    before = domains_in_words(varied)
    simulated = next(one for one in varied.conditions.values() if one.agent == "act@1000" and not one.is_real)
    fast = replace(simulated, setup={"frequency": 60.0})
    varied.register(fast)
    for seed in range(10):
        varied.add(make_row(fast, seed, success=False))
    assert domains_in_words(varied) == before


def test_domains_are_compared_over_agents_that_have_both(varied: Ledger, filled: Ledger) -> None:
    told = domains_in_words(varied)
    assert told is not None
    assert "4 agents" in told
    assert "correlation 1.00, mean maximum rank violation 0.00" in told
    assert domains_in_words(filled) is None


@pytest.mark.extras
def test_a_group_without_a_verdict_is_in_the_table_and_not_drawn(
    filled: Ledger, make_row: MakeRow, make_condition: MakeCondition
) -> None:
    condition = make_condition("delta")
    filled.register(condition)
    filled.add(make_row(condition, 0, success=None))
    path = write_figures(filled, "agent")
    assert "<td>delta</td><td>not judged</td><td>1</td>" in path.read_text()
    assert "delta" not in path.with_suffix(".svg").read_text()


@pytest.mark.extras
@pytest.mark.parametrize("by", ["steps", "robot", "mix"])
def test_files_and_page_have_the_rates(varied: Ledger, by: str) -> None:
    path = write_figures(varied, by)
    first = {kind: path.with_suffix(kind).read_bytes() for kind in (".svg", ".png", ".html")}
    assert first[".png"].startswith(b"\x89PNG")
    assert b"<svg" in first[".svg"]
    page = first[".html"].decode()
    assert page.count("<svg") == 1
    assert "judged = 80.0 %" in page or by != "steps"
    assert "Wilson" in page
    write_figures(varied, by)
    assert {kind: path.with_suffix(kind).read_bytes() for kind in first} == first
