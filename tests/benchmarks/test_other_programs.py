from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import pytest


def test_a_program_that_works_alone_does_not_find_the_machine_busy(
    tmp_path: Path, program: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    other_programs = program("rehearsal.other_programs")
    stat = tmp_path / "stat"
    monkeypatch.setattr(other_programs, "STAT", stat)

    def have_worked(seconds: float) -> None:
        stat.write_text(f"cpu  {round(seconds * os.sysconf('SC_CLK_TCK'))} 0 0 1000 0 0 0 0 0 0\ncpu0 1 2 3")

    have_worked(0.0)
    is_busy, began, before = other_programs.watch(), time.monotonic(), time.process_time()
    while time.process_time() < before + 0.3:
        pass
    have_worked(time.process_time() - before)
    assert not is_busy()
    have_worked(time.process_time() - before + 5.0 * (os.cpu_count() or 1) * (time.monotonic() - began))
    assert is_busy()
