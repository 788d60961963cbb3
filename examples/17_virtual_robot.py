"""Example 09 on a virtual FR3, controlled by the vendor's own library: the same program with another site.

`rcs virtual fr3` runs the same robot in a separate terminal. For a real one, only the site changes; watch the arm,
which starts at its present position. Needs the extra `franka`.
"""

from __future__ import annotations

import dataclasses
import runpy
import sys
import tempfile
from pathlib import Path

from rcs.virtual import VirtualProcess

PROGRAM = Path(__file__).with_name("09_site.py")

with tempfile.TemporaryDirectory() as folder, VirtualProcess("fr3", log=Path(folder) / "log.jsonl") as virtual:
    file = Path(folder) / "site.json"
    # The virtual robot has no camera, so use a fake one.
    site = dataclasses.replace(virtual.site, cameras={"wrist": "fake:0123456789"})
    site.write(file)
    print(f"{virtual.name} runs as process {virtual.pid}; its site:", file.read_text(), sep="\n")
    sys.argv = [str(PROGRAM), str(file)]
    runpy.run_path(str(PROGRAM), run_name="__main__")
