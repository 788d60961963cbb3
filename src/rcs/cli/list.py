"""`rcs list`: what there is to put together."""

from __future__ import annotations

from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

from rcs.devices import lookup
from rcs.setups.ids import ids
from rcs.setups.lab import lab_of


@dataclass(kw_only=True)
class ListCommand:
    """List robots, end effectors, cameras, tasks and environment ids."""

    def run(self) -> int:
        """Print them."""
        console = Console(soft_wrap=True)
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
            table.add_row("tactile sensor", name, lookup.find("tactile", name).label)
        for name in lookup.names("camera"):
            camera = lookup.find("camera", name)
            table.add_row("camera", name, f"{camera.label}, {'colour and depth' if camera.has_depth else 'colour'}")
        for name in lookup.names("lab"):
            lab = lab_of(name)
            arms = " and ".join(stand.arm for stand in lab.stands)
            cameras = ", ".join(f"{mount} {about.camera}" for mount, about in lab.cameras.items())
            table.add_row("robot", name, f"{arms} with {lab.end_effector}; cameras: {cameras}")
        for name in lookup.names("task"):
            table.add_row("task", name, (lookup.find("task", name).__doc__ or "").strip().splitlines()[0])
        for name in ids():
            table.add_row("id", name, "gymnasium.make")
        console.print(table)
        return 0
