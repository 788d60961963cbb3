"""Arms and grippers of the unruly driver, made as a site makes them, in hosts."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from rcs.hardware import Site, hosted
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND

HOME = np.array(FR3.home)
FAR = HOME + 0.5
SOON = 5.0
"""How long to wait for what takes a tenth of a second on an idle machine [s]."""


def wait_for(what: Callable[[], object]) -> None:
    limit = time.monotonic() + SOON
    while not what():
        assert time.monotonic() < limit, "waited in vain"
        time.sleep(0.002)


def made(kind: str, driver: str, address: str, about: Any, **options: Any) -> Any:
    """Make a device as a site does."""
    given = {"driver": driver, "address": address, "options": {"host": True, **options}}
    site = Site(**{f"{kind}s": {"fr3": given}})
    effector = about if kind != "arm" else None
    devices = site.devices({"fr3": (FR3, effector)}, {})
    return (devices.arms if kind == "arm" else devices.effectors)["fr3"]


def unruly_arm(box: Path, address: str = "unruly") -> Any:
    return made("arm", "unruly:UnrulyDriver", address, FR3, box=str(box))


def unruly_gripper(box: Path, address: str = "unruly") -> Any:
    return made("gripper", "unruly:UnrulyDriver", address, FRANKA_HAND, box=str(box))


PROGRAM = """
    import sys, time, signal
    sys.path[:] = {path!r}
    import os; os.environ["RCS_HOSTS"] = {folder!r}
    from rcs.hardware import Site
    from rcs.robots.fr3 import FR3
    import numpy as np
    site = Site(arms={{"fr3": {{"driver": "unruly:UnrulyDriver", "address": "unruly", "options": {{"box": {box!r}}}}}}})
    arm = site.devices({{"fr3": (FR3, None)}}, {{}}).arms["fr3"]
    arm.open()
    arm.command_joints(np.array(FR3.home) + 0.5)
    print(arm.host, flush=True)
    {end}
"""


def program(box: Path, end: str) -> tuple[subprocess.Popen[str], int]:
    """Start a program that moves an arm, and return it with the number of its host when the arm is under way."""
    text = textwrap.dedent(PROGRAM)
    text = text.format(path=sys.path, folder=os.environ[hosted.FOLDER], box=str(box), end=end)
    process = subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, int(process.stdout.readline())


def is_running(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
