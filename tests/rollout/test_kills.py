"""An evaluation that is killed again and again has the rows of one that is not."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parents[2] / "benchmarks" / "kill_evaluation.py"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="it finds processes in /proc")
def test_kills_of_evaluator_worker_and_server_change_no_row() -> None:
    command = [sys.executable, str(PROGRAM), "--trials", "3", "--episodes", "4"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    assert sum(told["kills"].values()) == 3
    assert told["equal"]
    assert told["run_again"] <= 2 * sum(told["kills"].values())
    assert told["damaged"] == 0
