"""No part of the library holds all images of an episode in memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

PROGRAM = Path(__file__).with_name("large_episode.py")


def run(megabytes: int, folder: Path) -> None:
    done = subprocess.run([sys.executable, PROGRAM, str(megabytes), folder], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_300_megabytes_are_recorded_checked_edited_and_read_with_less_memory(tmp_path: Path) -> None:
    run(300, tmp_path / "set")


def test_more_images_than_an_arrow_column_holds(tmp_path: Path) -> None:
    run(2200, tmp_path / "set")
