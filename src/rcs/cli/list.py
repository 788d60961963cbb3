"""`rcs list`: the parts of environments."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

from rcs_data.cli.console import plain_console
from rcs_data.cli.verbs import summary
from rich.table import Table

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
        grippers = ", ".join(name for name, _ in _installed("grippers"))
        for name, arm in _installed("arms"):
            table.add_row("arm", name, f"{arm.label}, {arm.dof} joints")
        for name, gripper in _installed("grippers"):
            table.add_row("end effector", name, f"{gripper.label}, {1000 * gripper.max_width:g} mm")
        for name, hand in _installed("hands"):
            grasps = ", ".join(hand.grasps)
            table.add_row("end effector", name, f"{hand.label}, {len(hand.joints)} joints; grasps: {grasps}")
        for name, tactile in _installed("tactiles"):
            table.add_row("tactile sensor", name, f"{tactile.label}, on the pads of {grippers}")
        for name, camera in _installed("cameras"):
            table.add_row("camera", name, f"{camera.label}, {'colour and depth' if camera.has_depth else 'colour'}")
        for name, lab in _installed("labs"):
            arms = " and ".join(stand.arm for stand in lab.stands)
            cameras = ", ".join(f"{mount} {about.camera}" for mount, about in lab.cameras.items())
            table.add_row("robot", name, f"{arms} with {lab.end_effector}; cameras: {cameras}")
        for kind in ("task", "agent", "operator", "layer", "gate", "driver"):
            for entry in sorted(entry_points(group=f"rcs.{kind}s")):
                table.add_row(kind, entry.name, summary(entry.value) or entry.name)
        for name in ids():
            table.add_row("id", name, "gymnasium.make")
        console.print(table)
        return 0


def _installed(kinds: str) -> list[tuple[str, Any]]:
    return [(entry.name, entry.load()) for entry in sorted(entry_points(group=f"rcs.{kinds}"))]


def _modes_of_cameras() -> Table:
    from rcs.sim.noise import nearest_depth  # imports the simulator

    table = Table("camera", "mode", "frames/s (~ rolling)", "focal [px]", "depth [m]", box=None, pad_edge=False)
    for name, camera in _installed("cameras"):
        for mode in camera.modes:
            rates = ", ".join(f"{'~' if rate * camera.longest_exposure > 1 else ''}{rate}" for rate in mode.rates)
            focal = camera.intrinsics(mode.width, mode.height)[1, 1]
            depth = "-"
            if camera.has_depth:
                depth = f"{nearest_depth(camera, (mode.width, mode.height)):g} .. {camera.depth_range[1]:g}"
            table.add_row(name, mode.name, rates, f"{focal:.1f}", depth)
    return table
