"""Every example and the README's program run as they are."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
MOST_LINES_IN_README = 12


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_tells_what_it_did(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out.strip()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_one_straight_script_of_30_to_90_lines(path: Path) -> None:
    assert 30 <= len(path.read_text().splitlines()) <= 90


def test_examples_are_numbered_without_gaps() -> None:
    assert [int(path.stem[:2]) for path in EXAMPLES] == list(range(len(EXAMPLES)))


def test_the_first_program_of_the_readme_runs_and_moves_the_arm(tmp_path: Path) -> None:
    program = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[0]
    assert len(program.strip().splitlines()) <= MOST_LINES_IN_README
    path = tmp_path / "program.py"
    path.write_text(program)
    names = runpy.run_path(str(path))
    assert names["observation"]["tquat"][2] < names["start"]["tquat"][2] - 0.05  # lower than at the start [m]
