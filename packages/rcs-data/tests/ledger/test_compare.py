"""Comparisons say who is better only if pairs show it, and the page has nothing that runs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from rcs_data.errors import InvalidSetup
from rcs_data.ledger import Ledger, write_ledger_page
from rcs_data.ledger.compare import compare
from rcs_data.ledger.page import comparison_page

if TYPE_CHECKING:
    from conftest import MakeCondition, MakeRow  # pyright: ignore[reportAttributeAccessIssue]

EVIL = "<img src=x onerror=hacked()>"


def test_seven_seeds_that_one_agent_alone_wins_show_that_it_is_better(filled: Ledger) -> None:
    (one,) = compare(filled, ["beta", "alpha"])
    assert one.winner == "alpha"
    assert one.words.startswith("alpha is better than beta on 8 shared seeds (-87.5 points")
    assert [verdicts.succeeded for verdicts in one.verdicts] == [1, 8]


def test_fewer_than_six_discordant_pairs_give_no_verdict(filled: Ledger) -> None:
    (one,) = compare(filled, ["alpha", "gamma"])
    assert one.winner is None
    assert "Not shown that alpha and gamma differ" in one.words
    assert "fewer than 6 give no verdict. About 61 shared seeds would show a difference of this size." in one.words


def test_of_several_agents_every_two_are_compared_and_p_values_adjusted(filled: Ledger) -> None:
    found = compare(filled)
    assert [(one.a, one.b) for one in found] == [("alpha", "beta"), ("alpha", "gamma"), ("beta", "gamma")]
    assert all(one.p >= one.pairs.p for one in found)
    assert found[0].p > found[0].pairs.p
    assert found[2].pairs.p < 0.05 < found[2].p
    assert found[2].words.endswith("About 11 shared seeds would show a difference of this size.")


def test_unasked_no_agent_is_compared_with_one_of_another_task_robot_or_domain(
    filled: Ledger, make_row: MakeRow
) -> None:
    before = compare(filled)
    others = ({"task": "Push"}, {"robot": "ur5e"}, {"platform": {"fr3": "franka"}})
    for change in others:
        other = replace(filled.condition(filled.find("beta")), agent=f"other {[*change]}", **change)
        filled.register(other)
        for seed in range(8):
            filled.add(make_row(other, seed, success=False))
    assert compare(filled) == before
    (one,) = compare(filled, ["alpha", "other ['task']"])
    assert one.winner == "alpha", "by name, anything is"


def test_after_looks_at_every_pair_the_e_value_alone_decides(filled: Ledger) -> None:
    (one,) = compare(filled, ["gamma", "beta"])
    assert one.winner == "gamma"
    one = replace(one, until=0.05)
    assert (one.pairs.only_a, one.winner) == (6, None)
    assert one.words.startswith("Not shown that gamma and beta differ")
    assert "e = 14.4, of 20 that are needed" in one.words
    assert "p = " not in one.words
    (one,) = compare(filled, ["alpha", "beta"])
    assert replace(one, until=0.05).winner == "alpha"


def test_what_differs_besides_the_agents_is_told(filled: Ledger, make_row: MakeRow) -> None:
    assert compare(filled, ["alpha", "beta"])[0].differences == {}
    other = replace(filled.condition(filled.find("alpha")), agent="slow", setup={"frequency": 5.0})
    filled.register(other)
    filled.add(make_row(other, 100))
    (one,) = compare(filled, ["alpha", "slow"])
    assert one.differences == {"setup.frequency": (30.0, 5.0)}
    assert one.words.startswith("Not comparable")


def test_one_agent_is_not_compared(filled: Ledger) -> None:
    with pytest.raises(InvalidSetup, match=r"1 agent .* to compare"):
        compare(filled, ["alpha", "alpha"])


def test_the_page_has_all_agents_their_own_films_and_words_are_words(filled: Ledger, make_row: MakeRow) -> None:
    evil = replace(filled.condition(filled.find("alpha")), agent=EVIL, tags={EVIL: EVIL})
    filled.register(evil, EVIL)
    row = make_row(evil, 3, success=False, message=EVIL, failure=EVIL, latency_p50=0.01, latency_p99=0.02)
    filled.add(row)
    (filled.folder / "films").mkdir()
    filled.film(row).write_bytes(b"")
    (filled.folder / "films" / "000000.mp4").write_bytes(b"a film of something else")
    text = write_ledger_page(filled).read_text()
    assert "<img" not in text
    assert text.count("<video") == 1
    assert f'src="films/{row.key}.mp4"' in text
    for words in (
        "8 of 8 judged = 100.0 %",
        "Not shown that alpha and beta differ",
        "10.0, 20.0",
        "runs/gamma",
        "left:12.50%",
    ):
        assert words in text


def test_a_page_of_many_agents_says_how_to_compare_two(
    filled: Ledger, make_condition: MakeCondition, make_row: MakeRow
) -> None:
    for number in range(10):
        assert "<h2>Comparison</h2><p>Pairs of episodes" in write_ledger_page(filled).read_text()
        more = make_condition(f"more-{number}")
        filled.register(more, "runs/more")
        assert filled.add(make_row(more, 0))
    words = f"too many agents to compare each with each here: rcs compare {filled.folder} A B"
    assert words in write_ledger_page(filled).read_text()


def test_a_page_states_both_values_and_when_each_holds(filled: Ledger) -> None:
    compared = compare(filled)
    page = str(comparison_page(filled, compared))
    for one in compared:
        assert f"e = {one.pairs.evidence:.2g}" in one.words
        assert one.words.replace("'", "&#x27;") in page
    assert "holds where the number of episodes was chosen beforehand" in page
    assert f"{20 * len(compared)} or more shows a difference" in page
