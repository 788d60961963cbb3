"""`rcs doctor`: what works on this machine, and remedies for what does not."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import sys
from contextlib import redirect_stdout
from dataclasses import dataclass, fields
from pathlib import Path

from rcs_data.cli.console import plain_console
from rcs_data.files.output import require_writable
from rich.table import Table

from rcs._core import probe_gl
from rcs.errors import InvalidSetup
from rcs.hardware.finding import Finding, as_json, as_page
from rcs.hardware.machine import worst
from rcs.hardware.site import KINDS, DeviceAddress, Site

PACKAGE = "robot-control-stack"
OPTIONAL = ("digit", "webcam")
"""Drivers that need no package for cameras at a URL."""
# A requirement of a package for an extra alone, such as 'rcs-data[mcap]>=0.1; extra == "mcap"'.
_NEED = re.compile(r"(?P<package>[\w.-]+)(?:\[(?P<extras>[^]]*)\])?[^;]*; *extra *== *['\"](?P<extra>[\w.-]+)['\"]")


@dataclass(kw_only=True)
class DoctorCommand:
    """Show what works on this machine, or examine a lab. Exit code 1 if nothing can draw, or the lab has a fault.

    With `--site`, the kernel, the network to each address and all devices are examined: they are opened, read for some
    seconds, held and closed. Nothing moves without `--move`.
    """

    site: Path | None = None
    """Site file of the lab to examine."""
    robot: str | None = None
    """Name of the robot, or of the lab with several; needed where the site's arms could be those of more than one."""
    end_effector: str | None = None
    """Name of the gripper or hand; the robot's usual one if left out, `none` for the flange."""
    setup: Path | None = None
    """JSON file of a setup in place of these two, for a lab with cameras of its own."""
    seconds: float = 10.0
    """How long the devices are read [s]."""
    move: bool = False
    """After a question, check clauses of the contract on every arm: its joints move by 0.05 rad and back, at 5 % of
    their speeds."""
    yes: bool = False
    """Do not ask before motions: somebody watches the arms."""
    json: bool = False
    """Print JSON."""
    page: Path | None = None
    """File for a page with the findings."""

    def run(self) -> int:
        """Print it."""
        if self.site is not None:
            return self._examine(self.site)
        if wrong := [own.name for own in fields(self) if getattr(self, own.name) != own.default]:
            names = ", ".join(f"--{name.replace('_', '-')}" for name in wrong)
            raise InvalidSetup(f"{names} has no meaning without --site, the site file of a lab to examine.")
        return self._show_machine()

    def _examine(self, path: Path) -> int:
        from rcs.cli.home import robot_of
        from rcs.cli.virtual import read_setup
        from rcs.rollout.examine import examine, setup_for
        from rcs.rollout.exercise import move
        from rcs.rollout.person import agrees

        if self.move and not self.yes and not sys.stdin.isatty():
            raise InvalidSetup("The input is no terminal, so nobody can be asked; give --yes where somebody watches.")
        if self.page is not None:
            require_writable(self.page, is_file=True)
        site = Site.read(path)
        if not any(getattr(site, kind) for kind in KINDS):
            raise InvalidSetup(f"{path} has no devices.")
        if self.setup is None:
            setup = setup_for(self.robot or robot_of(site), self.end_effector)
        elif self.robot is None and self.end_effector is None:
            setup = read_setup(self.setup)
        else:
            raise InvalidSetup("The setup of --setup names robot and end effector; leave out --robot, --end-effector.")
        console = plain_console()
        found = [*_packages(site), *examine(site, setup, seconds=self.seconds)]
        if self.move and worst(found) == "fault":
            remedy = "see to the faults; then try again"
            found.append(
                Finding(part="motion", status="warning", message="nothing moved: there is a fault", remedy=remedy)
            )
        elif self.move:

            def ask(question: str) -> bool:
                with redirect_stdout(sys.stderr if self.json else sys.stdout):  # the output is JSON alone
                    return self.yes or agrees(question)

            found += move(site, setup, ask)
        if self.page is not None:
            self.page.write_text(as_page(f"Examination of {path.name}", found), "utf-8")
        if self.json:
            print(as_json(found))
        else:
            table = Table("status", "part", "finding", "remedy", box=None, pad_edge=False)
            for one in found:
                table.add_row(one.status, one.part, one.message, one.remedy)
            console.print(table)
        return int(worst(found) == "fault")

    def _show_machine(self) -> int:
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


def _packages(site: Site) -> list[Finding]:
    """Return a finding per driver of a site: the versions of its extra's packages, or those that are missing."""
    found: list[Finding] = []
    every = [one for kind in KINDS for one in getattr(site, kind).values()]
    extras = importlib.metadata.metadata(PACKAGE).get_all("Provides-Extra") or ()
    needed = {
        one.driver
        for one in every
        if isinstance(one, DeviceAddress) and not (one.driver in OPTIONAL and "://" in one.address)
    }
    for driver in sorted(needed & set(extras)):
        part = f"driver {driver}"
        if lacking := missing(PACKAGE, driver):
            message, remedy = f"not installed: {', '.join(lacking)}", f"pip install '{PACKAGE}[{driver}]'"
            found.append(Finding(part=part, status="fault", message=message, remedy=remedy))
            continue
        needs = [need for line in importlib.metadata.requires(PACKAGE) or [] if (need := _NEED.fullmatch(line))]
        names = [need["package"] for need in needs if need["extra"] == driver]
        text = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names)
        found.append(Finding(part=part, status="ok", message=text))
    return found


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
        if not any(importlib.metadata.Distribution.discover(name=need["package"])):
            found.append(need["package"])
            continue
        for further in re.findall(r"[\w.-]+", need["extras"] or ""):
            found += missing(need["package"], further)
    return found
