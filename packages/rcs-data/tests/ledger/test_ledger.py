"""Ledgers: nothing is lost, nothing is overwritten, nothing is guessed, and other readers read them."""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import signal
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import duckdb
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.ledger import Condition, Ledger, write_ledger_page
from rcs_data.ledger.groups import groups_of

if TYPE_CHECKING:
    from conftest import MakeCondition, MakeRow  # pyright: ignore[reportAttributeAccessIssue]

CONDITION = Condition(
    agent="alpha", weights="ab12", trained=7, data="cd34", policy={"name": "p"}, execution={"mode": "rtc"},
    task="Pick", robot="fr3", setup={"frequency": 30.0, "cameras": {"names": ["wrist"]}, "layers": []},
    platform={"fr3": "franka"}, tags={"mix": "half"}, code={"rcs": "12"}, versions={"numpy": "2.1"},
)  # fmt: skip


def test_a_change_of_any_field_is_another_condition() -> None:
    changed: dict[str, Any] = {
        "agent": "beta", "weights": None, "trained": 8, "data": "cd35", "policy": {}, "execution": {"mode": "sync"},
        "task": "Place", "robot": "ur5e", "setup": {**CONDITION.setup, "frequency": 5.0}, "platform": {},
        "tags": {"mix": "whole"}, "code": {"rcs": "13"}, "versions": {"numpy": "2.2"},
    }  # fmt: skip
    assert set(changed) == set(CONDITION.to_json()), "every field is changed in this test"
    found = {replace(CONDITION, **{name: value}).hash for name, value in changed.items()}
    assert len(found | {CONDITION.hash}) == len(changed) + 1
    assert Condition.from_json(json.loads(json.dumps(CONDITION.to_json()))).hash == CONDITION.hash
    deep = replace(CONDITION, setup={**CONDITION.setup, "cameras": {"names": ["side"]}})
    assert CONDITION.differences(deep) == {"setup.cameras.names": (["wrist"], ["side"])}


def test_pandas_and_duckdb_read_what_is_there(filled: Ledger) -> None:
    path = filled.folder / "ledger.jsonl"
    frame = pd.read_json(path, lines=True, dtype=False)
    assert frame.groupby("agent")["success"].sum().to_dict() == {"alpha": 8, "beta": 1, "gamma": 7}
    counted = f"select agent, count(*) filter (success) from '{path}' group by agent"
    assert dict(duckdb.sql(counted).fetchall()) == {"alpha": 8, "beta": 1, "gamma": 7}


def test_seeds_keep_all_their_digits(tmp_path: Path, make_row: MakeRow) -> None:
    ledger = Ledger.open(tmp_path)
    seed = (1 << 60) + 4294967291
    ledger.add(make_row(CONDITION, seed))
    path = tmp_path / "ledger.jsonl"
    assert int(pd.read_json(path, lines=True, dtype=False)["seed"][0]) == seed
    assert duckdb.sql(f"select seed from '{path}'").fetchall() == [(seed,)]


def test_an_episode_is_there_once_and_stays_as_it_was(filled: Ledger, make_row: MakeRow) -> None:
    before = (filled.folder / "ledger.jsonl").read_bytes()
    row = next(iter(filled.rows.values()))
    condition = filled.condition(row.condition)
    assert not filled.add(make_row(condition, row.seed, success=False))
    assert (filled.folder / "ledger.jsonl").read_bytes() == before
    assert filled.add(make_row(condition, row.seed, repeat=1, success=False))
    assert Ledger(filled.folder).rows[row.name] == row
    assert len(filled.of(row.condition)) == 8, "repetitions are counted apart"


@settings(deadline=None)  # the disk may be busy
@given(place=st.integers(0, 10_000), junk=st.binary(min_size=1, max_size=4))
def test_damaged_lines_are_told_by_number_and_left_out(make_row: MakeRow, place: int, junk: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ledger.jsonl"
        data = b"".join(make_row(CONDITION, seed).line for seed in range(5))
        place %= len(data)
        damaged = data[:place] + junk + data[place + len(junk) :]
        path.write_bytes(damaged)
        again = Ledger(folder)
        whole = set(data.split(b"\n"))
        lines = damaged.split(b"\n")
        assert {row.line[:-1] for row in again.rows.values()} == whole & set(lines[:-1])
        for number, line in enumerate(lines, 1):
            is_told = any(f"Line {number} of" in sentence for sentence in again.damage)
            assert is_told == (line not in whole or (number == len(lines) and line != b""))


def test_what_a_kill_cut_short_is_told_and_then_replaced(filled: Ledger, make_row: MakeRow) -> None:
    path = filled.folder / "ledger.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole[:-30])
    cut = Ledger(filled.folder)
    assert len(cut.rows) == 23
    assert cut.damage == [f"Line 24 of {path} is left out: it is cut short."]
    assert cut.add(make_row(cut.condition(next(iter(cut.rows.values())).condition), 99))
    assert cut.damage == []
    assert Ledger(filled.folder).damage == []
    assert len(Ledger(filled.folder).rows) == 24


def test_four_writers_lose_nothing(tmp_path: Path, make_row: MakeRow, make_condition: MakeCondition) -> None:
    context = multiprocessing.get_context("fork")
    barrier = context.Barrier(4)

    def write(agent: str, first: int) -> None:
        condition = make_condition(agent)
        with Ledger.open(tmp_path / "l") as ledger:
            ledger.register(condition)
            barrier.wait()
            for seed in range(first, first + 50):
                ledger.add(make_row(condition, seed))

    work = [(agent, first) for agent in ("alpha", "beta") for first in (0, 50)]
    writers = [context.Process(target=write, args=one) for one in work]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(60)
    ledger = Ledger(tmp_path / "l")
    assert {(row.agent, row.seed) for row in ledger.rows.values()} == {
        (agent, seed) for agent in ("alpha", "beta") for seed in range(100)
    }
    assert ledger.damage == []
    assert len(list((tmp_path / "l" / "conditions").iterdir())) == 2


def test_several_processes_may_write_the_page_at_a_time(filled: Ledger) -> None:
    context = multiprocessing.get_context("fork")

    def write() -> None:
        for _ in range(20):
            write_ledger_page(Ledger(filled.folder))

    writers = [context.Process(target=write) for _ in range(4)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(60)
    assert [writer.exitcode for writer in writers] == [0] * 4
    assert (filled.folder / "report.html").read_text().endswith("</html>\n")
    assert not list(filled.folder.glob(".report*")), "no draft is left"


def test_processes_share_episodes_and_run_none_twice(tmp_path: Path, make_row: MakeRow) -> None:
    context = multiprocessing.get_context("fork")
    wins, barrier = context.Queue(), context.Barrier(3)
    Ledger.open(tmp_path / "l")

    def claim_all() -> None:
        with Ledger.open(tmp_path / "l") as ledger:
            barrier.wait()
            for seed in range(40):
                row = make_row(CONDITION, seed)
                if ledger.claim(row.key):
                    wins.put(seed)
                    ledger.add(row)

    writers = [context.Process(target=claim_all) for _ in range(3)]
    for writer in writers:
        writer.start()
    claimed = sorted(wins.get(timeout=60) for _ in range(40))
    for writer in writers:
        writer.join(60)
    assert claimed == list(range(40))
    assert wins.empty()


def test_the_claim_of_a_killed_process_is_free(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    ledger = Ledger.open(tmp_path / "l")
    ready = context.Event()

    def hold() -> None:
        mine = Ledger.open(tmp_path / "l")
        assert mine.claim("a-1")
        ready.set()
        time.sleep(60)

    holder = context.Process(target=hold)
    holder.start()
    assert ready.wait(30)
    assert not ledger.claim("a-1")
    assert ledger.claim("a-2")
    os.kill(holder.pid or 0, signal.SIGKILL)
    holder.join(30)
    assert ledger.claim("a-1")


@pytest.mark.slow
def test_kills_at_any_moment_leave_whole_rows(tmp_path: Path, make_row: MakeRow) -> None:
    context, rng = multiprocessing.get_context("fork"), random.Random(4)

    def write() -> None:
        with Ledger.open(tmp_path / "l") as ledger:
            condition = CONDITION
            ledger.register(condition)
            for seed in range(10_000):
                if ledger.claim(f"{condition.hash}-{seed}"):
                    ledger.add(make_row(condition, seed))

    seen = 0
    for _ in range(20):
        writer = context.Process(target=write)
        writer.start()
        time.sleep(rng.uniform(0.02, 0.3))
        os.kill(writer.pid or 0, signal.SIGKILL)
        writer.join(30)
        if (tmp_path / "l" / "ledger.jsonl").exists():
            ledger = Ledger(tmp_path / "l")
            assert len(ledger.rows) >= seen
            seen = len(ledger.rows)
            assert [row.seed for row in ledger.rows.values()] == list(range(seen))
    assert seen > 20


def test_a_folder_with_something_else_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(DatasetError, match=r"thesis\.tex.*another folder"):
        Ledger.open(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    with pytest.raises(DatasetError, match="There is no ledger"):
        Ledger(tmp_path / "nowhere")
    assert not (tmp_path / "nowhere").exists()


def test_a_ledger_that_another_process_makes_meanwhile_is_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listed = Path.iterdir

    def iterdir(folder: Path) -> Any:
        (tmp_path / "ledger.jsonl").touch()
        return listed(folder)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    assert Ledger.open(tmp_path).rows == {}


def test_agents_are_found_by_name_and_by_hash(filled: Ledger, make_row: MakeRow) -> None:
    first = filled.find("alpha")
    assert filled.find(first[:6]) == first
    assert filled.place(first) == "runs/alpha"
    with pytest.raises(InvalidSetup, match=r"No agent .* 'delta'.*alpha \(.*beta \("):
        filled.find("delta")
    other = replace(filled.condition(first), setup={"frequency": 5.0})
    filled.register(other)
    filled.add(make_row(other, 1))
    with pytest.raises(InvalidSetup, match=r"2 conditions, which differ in setup\.frequency"):
        filled.find("alpha")
    assert filled.find("alpha", besides=first) == other.hash
    assert filled.find("beta", besides=filled.find("beta")) == filled.find("beta")


def test_two_comparisons_of_one_agent_that_are_revealed_are_told_apart(tmp_path: Path, make_row: MakeRow) -> None:
    ledger = Ledger.open(tmp_path / "l")
    for nonce in ("one", "two"):
        blind = replace(CONDITION, agent="X", weights=None, tags={**CONDITION.tags, "blind": nonce})
        ledger.register(blind, hidden=(CONDITION, "vla://host:1"))
        ledger.add(make_row(blind, 1))
    ledger.unblind()
    revealed = [(one.agent, one.tags["blind"]) for one in ledger.conditions.values()]
    assert revealed == [("alpha", "one"), ("alpha", "two")]
    with pytest.raises(InvalidSetup, match=r"2 conditions, which differ in tags\.blind\. Give"):
        ledger.find("alpha")


def test_a_description_that_was_changed_is_told(filled: Ledger) -> None:
    path = filled.folder / "conditions" / f"{filled.find('beta')}.json"
    path.write_bytes(path.read_bytes().replace(b"fr3", b"fr4"))
    with pytest.raises(CorruptEpisode, match="checksum"):
        Ledger(filled.folder).conditions  # noqa: B018


def test_a_corrected_answer_takes_the_place_of_the_one_before(filled: Ledger, make_row: MakeRow) -> None:
    first = list(filled.rows)
    row = filled.rows[first[3]]
    condition = filled.condition(row.condition)
    for corrections, success in ((1, not row.success), (2, None)):
        assert filled.add(make_row(condition, row.seed, success=success, corrections=corrections))
        assert not filled.add(make_row(condition, row.seed, success=True, corrections=corrections))
    again = Ledger(filled.folder)
    for ledger in (filled, again):
        assert list(ledger.rows) == first
        assert (ledger.rows[row.name].success, ledger.rows[row.name].corrections) == (None, 2)
    frame = pd.read_json(filled.folder / "ledger.jsonl", lines=True, dtype=False)
    latest = frame.drop_duplicates(["key", "repeat"], keep="last")
    assert (len(frame), len(latest), latest["corrections"].sum()) == (26, 24, 2)


def test_a_revealed_comparison_is_of_the_series_of_its_agent(tmp_path: Path, make_row: MakeRow) -> None:
    ledger, simulated = Ledger.open(tmp_path / "l"), replace(CONDITION, platform={})
    blind = replace(CONDITION, agent="X", weights=None, tags={**CONDITION.tags, "blind": "one"})
    ledger.register(simulated)
    ledger.register(blind, hidden=(CONDITION, "vla://host:1"))
    for condition in (simulated, blind):
        ledger.add(make_row(condition, 1))
    ledger.unblind()
    assert {one.series for one in groups_of(ledger, "domain")} == {""}
