"""Other programs are named in messages."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from rcs.hardware.programs import holders


def test_the_program_that_has_a_file_open_is_named(tmp_path: Path) -> None:
    file = tmp_path / "video7"
    words = f"open({str(file)!r}, 'w'); print(flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", f"held = {words}"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        other.stdout.readline()
        (name,) = holders(str(file))
        assert name.startswith(f"process {other.pid} (python")
        other.communicate(b"\n")
    assert holders(str(file)) == []
