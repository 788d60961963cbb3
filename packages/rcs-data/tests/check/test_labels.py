from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from rcs_data import check, edit

if TYPE_CHECKING:
    from conftest import MakeMoving


def kinds(path: Path) -> list[tuple[str | None, str]]:
    return [(finding.episode, finding.kind) for finding in check(path).findings]


def test_episodes_without_a_verdict_are_told_once(tmp_path: Path, moving: MakeMoving) -> None:
    assert kinds(moving(tmp_path / "none", success=None, episodes=3, length=3)) == [(None, "no_verdict")]
    mixed = edit.merge(
        [moving(tmp_path / "a", success=True, length=3), moving(tmp_path / "b", success=None, length=3)],
        tmp_path / "out",
    ).path
    (finding,) = check(mixed).findings
    assert "1 of 2 episodes have no verdict: b.000000" in finding.message


@pytest.mark.parametrize(("episodes", "is_found"), [(2, False), (3, True)])
def test_that_all_failed_is_told_when_it_is_no_chance(
    tmp_path: Path, moving: MakeMoving, episodes: int, is_found: bool
) -> None:
    path = moving(tmp_path, success=False, episodes=episodes, length=3)
    assert kinds(path) == ([(None, "all_failed")] if is_found else [])


def test_a_success_that_says_how_it_failed_is_a_contradiction(tmp_path: Path, moving: MakeMoving) -> None:
    assert kinds(moving(tmp_path / "a", outcome={"failure": None}, length=3)) == []
    assert kinds(moving(tmp_path / "b", outcome={"failure": "slip"}, length=3)) == [("000000", "contradiction")]


def test_a_missing_instruction_is_told_until_it_is_there(tmp_path: Path, moving: MakeMoving) -> None:
    path = moving(tmp_path, instruction=" ", length=3)
    assert kinds(path) == [("000000", "no_instruction")]
    edit.relabel(path, "pick")
    assert kinds(path) == []


def test_an_episode_of_one_row_has_no_action(tmp_path: Path, moving: MakeMoving) -> None:
    assert kinds(moving(tmp_path, length=1)) == [("000000", "no_action")]
