"""`rcs doctor`: what works on this machine, and what to do about what does not."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
from dataclasses import dataclass

from rich.table import Table

from rcs._core import probe_gl
from rcs.cli.console import plain_console

EXTRAS = {
    "menagerie": "mujoco_menagerie",
    "tacto": "tacto",
    "hdf5": "h5py",
    "rerun": "rerun",
    "torch": "torch",
    "rl": "stable_baselines3",
}
"""Extras by the module that shows that they are installed."""


@dataclass(kw_only=True)
class DoctorCommand:
    """Tell what works on this machine. Exit code 1 when nothing can draw."""

    def run(self) -> int:
        """Print it."""
        console = plain_console()
        table = Table(show_header=False, box=None, pad_edge=False)
        table.add_row("python", f"{platform.python_version()} on {platform.platform()}, {os.cpu_count()} CPUs")
        for name in ("robot-control-stack", "mujoco-core", "numpy", "gymnasium", "pyarrow"):
            table.add_row(name, importlib.metadata.version(name))
        probes = probe_gl()
        chosen = next((probe.name for probe in probes if probe.ok), None)
        for probe in probes:
            verdict = (
                "chosen: the first that works" if probe.name == chosen else "works" if probe.ok else "does not work"
            )
            table.add_row(f"GL {probe.name}", f"{verdict} ({probe.detail})")
        display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        table.add_row("display", display or "none: no viewer, everything else works")
        for extra, module in EXTRAS.items():
            found = importlib.util.find_spec(module) is not None
            table.add_row(
                f"extra {extra}",
                "installed" if found else f"not installed: pip install 'robot-control-stack[{extra}]'",
            )
        console.print(table)
        if chosen is None:
            console.print("Nothing can draw: cameras will not work until one of the remedies above is done.")
            return 1
        return 0
