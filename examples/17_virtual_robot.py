"""Example 09 on a virtual FR3, which the vendor's own library drives: the same program, another site.

`rcs virtual fr3` has the same robot in a terminal of its own. For a real one, nothing but the site changes, and
somebody watches: the arm begins where it stands. Needs the extra `franka`.
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
    # The robot is the virtual one; no camera looks at it, so a fake one stands in.
    site = dataclasses.replace(virtual.site, cameras={"wrist": "fake:0123456789"})
    site.write(file)
    print(f"{virtual.name} runs as process {virtual.pid}; its site:", file.read_text(), sep="\n")
    sys.argv = [str(PROGRAM), str(file)]
    runpy.run_path(str(PROGRAM), run_name="__main__")
