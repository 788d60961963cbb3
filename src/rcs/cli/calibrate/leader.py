"""`rcs calibrate leader`: signs and offsets of a leader's joints."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from rcs_data.cli.console import plain_console
from rcs_data.files.output import require_writable

from rcs.devices import lookup
from rcs.errors import InvalidSetup
from rcs.robots.description import ArmDescription
from rcs.rollout.person import read_line
from rcs.teleop.gello import DynamixelBus
from rcs.teleop.leader import LeaderBus, LeaderCalibration, calibrate_leader
from rcs.teleop.so101_leader import So101Bus, uncalibrated


@dataclass(kw_only=True)
class LeaderCommand:
    """Find the signs and offsets of a leader's joints, in a minute with the leader in your hands.

    Its motors are switched off; hold it before it falls. The file is the leader's address: `--input gello:leader.json`.
    """

    leader: Literal["gello", "so101_leader"] = "gello"
    """Kind of the leader."""
    port: str
    """Its serial port, such as /dev/ttyUSB0."""
    robot: str = "fr3"
    """Name of the arm that will follow."""
    servos: tuple[int, ...] = ()
    """Numbers of a GELLO's servos, from the base to the gripper; 1, 2, 3 … if left out."""
    baud: int = 57600
    """Speed of a GELLO's serial line [bit/s]."""
    out: Path = Path("leader.json")
    """File to write."""

    def run(self) -> int:
        """Ask the person, and write the file."""
        if not sys.stdin.isatty():
            raise InvalidSetup("The input is no terminal, so nobody can be asked; run this in one.")
        require_writable(self.out, is_file=True)
        console = plain_console()
        arm: ArmDescription = lookup.find("arm", self.robot)
        draft, join = self._draft(arm)

        def ask(text: str) -> None:
            read_line(f"{text} ")

        found = calibrate_leader(draft, arm, join, ask=ask, show=console.print)
        found.write(self.out)
        console.print(f"{self.out}: the leader at {self.port} for {arm.label}")
        return 0

    def _draft(self, arm: ArmDescription) -> tuple[LeaderCalibration, Callable[[LeaderCalibration], LeaderBus]]:
        if self.leader == "so101_leader":
            return uncalibrated(self.port), So101Bus
        servos = self.servos or tuple(range(1, arm.dof + 2))
        return replace(uncalibrated(self.port, servos), baud=self.baud), DynamixelBus
