"""`rcs home`: all arms of a site, slowly, to where they are at home."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

from rcs_data.cli.console import plain_console

from rcs.devices import lookup
from rcs.envs.setup import Setup
from rcs.envs.step.approach import SPEED
from rcs.errors import InvalidSetup, Refused
from rcs.hardware.site import Site
from rcs.rollout.person import agrees
from rcs.setups.lab import lab_of
from rcs.setups.make import make


@dataclass(kw_only=True)
class HomeCommand:
    """Move all arms of a site home, slowly, after a question. Exit code 1 if the answer is no.

    Each joint goes straight to its place, and only the person who answers looks for obstacles. Ctrl-C has all arms
    hold.
    """

    site: Path
    """File of the site."""
    robot: str | None = None
    """Name of the robot, or of the lab with several; needed where the site's arms could be those of more than one."""
    end_effector: str | None = None
    """Name of the gripper or hand; the robot's usual one if left out, `none` for the flange."""
    speed: float = SPEED
    """Largest speed of a joint, as a share of its limit."""
    yes: bool = False
    """Do not ask before motions: somebody watches the arms."""

    def run(self) -> int:
        """Ask, move, and return the exit code."""
        console = plain_console()
        if not self.yes and not sys.stdin.isatty():
            raise InvalidSetup("The input is no terminal, so nobody can be asked; give --yes where somebody watches.")
        site = replace(Site.read(self.site), cameras={}, tactile={})
        if not site.arms:
            raise InvalidSetup(f"{self.site} has no arms.")
        setup = Setup(
            task="Free", robot=self.robot or robot_of(site), end_effector=self.end_effector, max_episode_steps=None
        )

        with make(setup, hardware=site) as env:
            home = {name: {"joints": list(env.robots[name].arm.home)} for name in site.arms}
            robot = home if len(env.robots) > 1 else home[next(iter(env.robots))]
            try:
                env.reset(options={"robot": robot, "may_move": True if self.yes else agrees, "speed": self.speed})
            except Refused as err:
                console.print(str(err))
                return 1
        console.print(f"At home: {', '.join(site.arms)}")
        return 0


def robot_of(site: Site) -> str:
    """Return the robot whose arms are those of a site.

    Raises:
        InvalidSetup: There is none, or more than one.
    """
    labs = sorted({*lookup.names("lab"), *lookup.names("arm")})
    fitting = [name for name in labs if {stand.name for stand in lab_of(name).stands} == set(site.arms)]
    if len(fitting) != 1:
        known = f"could be those of {', '.join(fitting)}" if fitting else "are those of no robot that is known"
        raise InvalidSetup(f"The site's arms ({', '.join(site.arms)}) {known}; name one with --robot.")
    return fitting[0]
