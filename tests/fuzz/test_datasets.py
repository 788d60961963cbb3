"""Forty damaged datasets are read or refused, and nothing else happens; `datasets.py` tries thousands."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path


def test_a_damaged_dataset_is_read_or_refused() -> None:
    command = [sys.executable, str(Path(__file__).with_name("datasets.py")), "--trials", "40", "--seed", "0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["kinds"] == []
    assert told["trials"] == 40
    assert min(told["outcomes"]["done"], told["outcomes"]["refused"]) > 25, (
        "the damage is neither too small nor too large"
    )
