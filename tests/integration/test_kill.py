"""Kill -9 of a whole collection: finished episodes stay, the open one comes back."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "kill.py"


@pytest.mark.slow
def test_sigkill_damages_nothing_and_loses_at_most_half_a_second() -> None:
    done = subprocess.run(
        [sys.executable, str(BENCHMARK), "--trials", "6", "--seed", "3"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["lossless"] == 6
    assert result["damaged"] == result["half_edits"] == 0
    assert result["checks_failed_after_recover"] == 0
    assert result["exact_losses"] == 2
    assert result["lost_s_max"] <= 0.5
