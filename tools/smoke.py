"""Test an installed wheel: make and step an environment, and run the command `rcs`."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from pathlib import Path

import rcs

if Path(sysconfig.get_path("platlib")) not in Path(rcs.__file__).parents:
    sys.exit(f"This is about an installed wheel; rcs is in {Path(rcs.__file__).parent}.")
env = rcs.make("PickCuboid")
env.reset(seed=0)
for _ in range(10):
    env.step(env.action_space.sample())
env.close()
command = Path(sysconfig.get_path("scripts")) / "rcs"
for argument, word in (("--version", rcs.__version__), ("list", "PickCuboid")):
    told = subprocess.run([command, argument], check=True, capture_output=True, text=True).stdout
    if word not in told:
        sys.exit(f"`rcs {argument}` says nothing of {word!r}: {told}")
print(f"rcs {rcs.__version__} works with Python {sys.version.partition(' ')[0]}")
