"""A check of a dataset that is edited meanwhile tells of no damage where there is none."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from rcs_data import Dataset, check, edit
from rcs_data.check import dataset as whole_dataset

if TYPE_CHECKING:
    from conftest import MakeMoving

HERE = Path(__file__).parent


def test_an_edit_that_came_when_the_index_was_just_read_is_no_damage(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read_index = whole_dataset.check_folder

    def read_and_edit(root: Path) -> object:
        found = read_index(root)
        edit.trim(root, "000001")
        (root / "former/000001/frames.zip").unlink()  # as if it were being pruned
        return found

    monkeypatch.setattr(whole_dataset, "check_folder", read_and_edit)
    assert {finding.kind for finding in check(dataset).findings} == {"former"}


def test_a_check_beside_edits_finds_nothing(tmp_path: Path, moving: MakeMoving) -> None:
    path = moving(tmp_path / "set", length=60, episodes=3)
    checks = 0
    with subprocess.Popen([sys.executable, HERE / "edit_again_and_again.py", path, "60"]) as editor:
        while editor.poll() is None:
            report = check(path)
            assert not report.findings, f"check {checks}: {report}"
            checks += 1
    assert editor.returncode == 0
    assert checks > 5
    assert len(Dataset.open(path)) == 3
