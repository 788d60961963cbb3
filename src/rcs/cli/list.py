"""`rcs list`: what there is to put together."""

from __future__ import annotations

from dataclasses import dataclass

from rich.table import Table

from rcs.cli.console import plain_console
from rcs.devices import lookup
from rcs.robots.description import CameraDescription
from rcs.setups.ids import ids
from rcs.setups.lab import lab_of
from rcs.sim.noise import nearest_depth


@dataclass(kw_only=True)
class ListCommand:
    """List robots, end effectors, cameras, tasks and environment ids."""

    cameras: bool = False
    """List the resolution modes of cameras instead, with what each sees."""

    def run(self) -> int:
        """Print them."""
        console = plain_console()
        if self.cameras:
            console.print(_modes_of_cameras())
            return 0
        table = Table("kind", "name", "what", box=None, pad_edge=False)
        for name in lookup.names("arm"):
            arm = lookup.find("arm", name)
            table.add_row("arm", name, f"{arm.label}, {arm.dof} joints")
        for name in lookup.names("gripper"):
            gripper = lookup.find("gripper", name)
            table.add_row("end effector", name, f"{gripper.label}, {1000 * gripper.max_width:g} mm")
        for name in lookup.names("hand"):
            hand = lookup.find("hand", name)
            table.add_row(
                "end effector", name, f"{hand.label}, {len(hand.joints)} joints; grasps: {', '.join(hand.grasps)}"
            )
        for name in lookup.names("tactile"):
            mounts = ", ".join(lookup.names("gripper"))
            table.add_row("tactile sensor", name, f"{lookup.find('tactile', name).label}, on the pads of {mounts}")
        for name in lookup.names("camera"):
            camera = lookup.find("camera", name)
            table.add_row("camera", name, f"{camera.label}, {'colour and depth' if camera.has_depth else 'colour'}")
        for name in lookup.names("lab"):
            lab = lab_of(name)
            arms = " and ".join(stand.arm for stand in lab.stands)
            cameras = ", ".join(f"{mount} {about.camera}" for mount, about in lab.cameras.items())
            table.add_row("robot", name, f"{arms} with {lab.end_effector}; cameras: {cameras}")
        for name in lookup.names("task"):
            words = (lookup.find("task", name).__doc__ or name).strip()
            table.add_row("task", name, words.partition("\n")[0])
        for name in ids():
            table.add_row("id", name, "gymnasium.make")
        console.print(table)
        return 0


def _modes_of_cameras() -> Table:
    table = Table("camera", "mode", "frames/s (~ rolling)", "focal [px]", "depth [m]", box=None, pad_edge=False)
    for name in lookup.names("camera"):
        camera: CameraDescription = lookup.find("camera", name)
        for mode in camera.modes:
            rates = ", ".join(f"{'~' if rate * camera.longest_exposure > 1 else ''}{rate}" for rate in mode.rates)
            focal = camera.intrinsics(mode.width, mode.height)[1, 1]
            depth = "-"
            if camera.has_depth:
                depth = f"{nearest_depth(camera, (mode.width, mode.height)):g} .. {camera.depth_range[1]:g}"
            table.add_row(name, mode.name, rates, f"{focal:.1f}", depth)
    return table
