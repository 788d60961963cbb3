"""`rcs list`: the parts of environments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from rcs_data.cli.console import plain_console
from rcs_data.cli.program import summary
from rich.table import Table

from rcs.devices import lookup
from rcs.errors import InvalidSetup
from rcs.setups.ids import ids


@dataclass(kw_only=True)
class ListCommand:
    """List robots, end effectors, sensors, tasks, agents, input devices, layers, gates, drivers and environment ids."""

    cameras: bool = False
    """List the modes of cameras instead, with focal length and depth range."""

    devices: bool = False
    """List what is plugged in instead, as lines for a site file."""

    def run(self) -> int:
        """Print them."""
        console = plain_console()
        if self.devices:
            from rcs.hardware.plugged_in import site_lines

            for line in site_lines():
                print(line)
            return 0
        if self.cameras:
            console.print(_modes_of_cameras())
            return 0
        table = Table("kind", "name", "what", box=None, pad_edge=False)
        for kind, shown, describe in _PARTS:
            for entry in sorted(entry_points(group=f"rcs.{kind}s")):
                table.add_row(shown, entry.name, _described(entry, describe))
        for name in ids():
            table.add_row("id", name, "gymnasium.make")
        console.print(table)
        return 0


def _described(entry: EntryPoint, describe: Callable[[Any], str] | None) -> str:
    try:
        return (summary(entry.value) or entry.name) if describe is None else describe(entry.load())
    except Exception as err:  # noqa: BLE001  one broken package does not hide the others
        package = "" if entry.dist is None else f" of the package {entry.dist.name}"
        return f"broken: {entry.value}{package}: {type(err).__name__}: {err}"


def _lab(lab: Any) -> str:
    arms = " and ".join(stand.arm for stand in lab.stands)
    cameras = ", ".join(f"{mount} {about.camera}" for mount, about in lab.cameras.items())
    return f"{arms} with {lab.end_effector}; cameras: {cameras}"


_PARTS: tuple[tuple[str, str, Callable[[Any], str] | None], ...] = (
    ("arm", "arm", lambda arm: f"{arm.label}, {arm.dof} joints"),
    ("gripper", "end effector", lambda gripper: f"{gripper.label}, {1000 * gripper.max_width:g} mm"),
    ("hand", "end effector", lambda it: f"{it.label}, {len(it.joints)} joints; grasps: {', '.join(it.grasps)}"),
    ("tactile", "tactile sensor", lambda it: f"{it.label}, on the pads of {', '.join(lookup.names('gripper'))}"),
    ("camera", "camera", lambda it: f"{it.label}, {'colour and depth' if it.has_depth else 'colour'}"),
    ("lab", "robot", _lab),
    ("task", "task", None),
    ("agent", "agent", None),
    ("input", "input device", None),
    ("layer", "layer", None),
    ("gate", "gate", None),
    ("driver", "driver", None),
)
"""Kinds of parts, their names in the list, and their descriptions; None for the first sentence of the docstring."""


def _modes_of_cameras() -> Table:
    from rcs.sim.noise import nearest_depth  # imports the simulator

    table = Table("camera", "mode", "frames/s (~ rolling)", "focal [px]", "depth [m]", box=None, pad_edge=False)
    for name in lookup.names("camera"):
        try:
            camera = lookup.find("camera", name)
        except InvalidSetup:
            table.add_row(name, "broken; see `rcs list`")
            continue
        for mode in camera.modes:
            rates = ", ".join(f"{'~' if rate * camera.longest_exposure > 1 else ''}{rate}" for rate in mode.rates)
            focal = camera.intrinsics(mode.width, mode.height)[1, 1]
            depth = "-"
            if camera.has_depth:
                depth = f"{nearest_depth(camera, (mode.width, mode.height)):g} .. {camera.depth_range[1]:g}"
            table.add_row(name, mode.name, rates, f"{focal:.1f}", depth)
    return table
