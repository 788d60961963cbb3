"""`rcs doctor`: what works on this machine, and remedies for what does not."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
from dataclasses import dataclass

from rcs_data.cli.console import plain_console
from rich.table import Table

from rcs._core import probe_gl

PACKAGE = "robot-control-stack"
# What a package needs for an extra and nothing else, such as 'rcs-data[mcap]>=0.1; extra == "mcap"'.
_NEED = re.compile(r"(?P<package>[\w.-]+)(?:\[(?P<extras>[^]]*)\])?[^;]*; *extra *== *['\"](?P<extra>[\w.-]+)['\"]")


@dataclass(kw_only=True)
class DoctorCommand:
    """Show what works on this machine. Exit code 1 if nothing can draw."""

    def run(self) -> int:
        """Print it."""
        console = plain_console()
        table = Table(show_header=False, box=None, pad_edge=False)
        table.add_row("python", f"{platform.python_version()} on {platform.platform()}, {os.cpu_count()} CPUs")
        for name in (PACKAGE, "mujoco-core", "numpy", "gymnasium", "pyarrow"):
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
        for extra in importlib.metadata.metadata(PACKAGE).get_all("Provides-Extra") or ():
            lacking = missing(PACKAGE, extra)
            remedy = f"not installed ({', '.join(lacking)}): pip install '{PACKAGE}[{extra}]'"
            table.add_row(f"extra {extra}", remedy if lacking else "installed")
        console.print(table)
        if chosen is None:
            console.print("Nothing can draw: cameras need one of the remedies above.")
            return 1
        return 0


def missing(package: str, extra: str) -> list[str]:
    """Return the packages that an extra of an installed package lacks, those of further extras that it names included.

    Args:
        package: The package.
        extra: Its extra.
    """
    found: list[str] = []
    for line in importlib.metadata.requires(package) or []:
        need = _NEED.fullmatch(line)
        if need is None or need["extra"] != extra:
            continue
        if not _is_installed(need["package"]):
            found.append(need["package"])
            continue
        for further in re.findall(r"[\w.-]+", need["extras"] or ""):
            found += missing(need["package"], further)
    return found


def _is_installed(package: str) -> bool:
    try:
        importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True
