"""`rcs list`: the parts of environments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points

from rcs_data.cli.console import plain_console
from rcs_data.cli.verbs import summary
from rich.table import Table

from rcs.devices import lookup
from rcs.errors import InvalidSetup
from rcs.setups.ids import ids


@dataclass(kw_only=True)
class ListCommand:
    """List robots, end effectors, cameras, tasks and environment ids."""

    cameras: bool = False
    """List the modes of cameras instead, with focal length and depth range."""

    def run(self) -> int:
        """Print them."""
        console = plain_console()
        if self.cameras:
            console.print(_modes_of_cameras())
            return 0
        table = Table("kind", "name", "what", box=None, pad_edge=False)
        for kind, shown, about in _PARTS:
            for entry in sorted(entry_points(group=f"rcs.{kind}s")):
                table.add_row(shown, entry.name, _told(entry, about))
        for name in ids():
            table.add_row("id", name, "gymnasium.make")
        console.print(table)
        return 0


def _told(entry: EntryPoint, about: Callable[[EntryPoint], str]) -> str:
    try:
        return about(entry)
    except Exception as err:  # noqa: BLE001  one broken package does not hide the others
        package = "" if entry.dist is None else f" of the package {entry.dist.name}"
        return f"broken: {entry.value}{package}: {type(err).__name__}: {err}"


def _arm(entry: EntryPoint) -> str:
    arm = entry.load()
    return f"{arm.label}, {arm.dof} joints"


def _gripper(entry: EntryPoint) -> str:
    gripper = entry.load()
    return f"{gripper.label}, {1000 * gripper.max_width:g} mm"


def _hand(entry: EntryPoint) -> str:
    hand = entry.load()
    return f"{hand.label}, {len(hand.joints)} joints; grasps: {', '.join(hand.grasps)}"


def _tactile(entry: EntryPoint) -> str:
    return f"{entry.load().label}, on the pads of {', '.join(lookup.names('gripper'))}"


def _camera(entry: EntryPoint) -> str:
    camera = entry.load()
    return f"{camera.label}, {'colour and depth' if camera.has_depth else 'colour'}"


def _lab(entry: EntryPoint) -> str:
    lab = entry.load()
    arms = " and ".join(stand.arm for stand in lab.stands)
    cameras = ", ".join(f"{mount} {about.camera}" for mount, about in lab.cameras.items())
    return f"{arms} with {lab.end_effector}; cameras: {cameras}"


def _sentence(entry: EntryPoint) -> str:
    return summary(entry.value) or entry.name


_PARTS: tuple[tuple[str, str, Callable[[EntryPoint], str]], ...] = (
    ("arm", "arm", _arm),
    ("gripper", "end effector", _gripper),
    ("hand", "end effector", _hand),
    ("tactile", "tactile sensor", _tactile),
    ("camera", "camera", _camera),
    ("lab", "robot", _lab),
    *((kind, kind, _sentence) for kind in ("task", "agent", "operator", "layer", "gate", "driver")),
)
"""Kinds of parts, what they are called, and what is told about one."""


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
