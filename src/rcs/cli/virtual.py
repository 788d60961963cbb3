"""`rcs virtual`: a robot to rehearse with, which speaks its vendor's protocol; and what goes wrong with it."""

from __future__ import annotations

import json
import signal
from dataclasses import dataclass
from pathlib import Path

import tyro

from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup


@dataclass(kw_only=True)
class VirtualCommand:
    """Run a virtual robot behind its vendor's protocol until SIGTERM or Ctrl-C, or cause a fault in one that runs.

    `rcs virtual so101` prints one line of JSON when it is ready: its name, and the site at which drivers find it.
    `rcs virtual tell NAME FAULT` causes a fault in one that runs, such as `freeze 2`, `cut`, `late 60/100`
    (one packet in 100 comes 60 ms late), `lose 3` or `corrupt 3`; `reset SEED` places the objects anew, and `clear`
    mends everything. A camera or tactile sensor has a name such as `fr3/wrist`, and the faults `freeze S`, `delay MS`,
    `drop P`, `black`, `tear`, `unplug S`, `swap OTHER` and `clear`. `judge` answers whether the task was done since
    the objects were placed, `look` with their poses, and `about` with name, site and setup.
    """

    words: tyro.conf.Positional[tuple[str, ...]]
    """Name of a robot, such as so101, or: tell NAME FAULT [VALUE]."""
    address: str | None = None
    """Where it listens: an address of this machine such as 127.0.0.2, or the path of a serial port to make; None for
    the usual one."""
    setup: Path | None = None
    """JSON file of a setup, for another scene than that of the robot's usual task."""
    seed: int = 0
    """Where the objects are: as in an environment that is reset with this seed."""
    log: Path | None = None
    """File for what it gets and does, as JSON lines; every tick is in a binary file beside it."""
    cameras: tuple[str, ...] = ()
    """Cameras of the lab that it serves, too, such as: wrist side."""
    depth: bool = False
    """Serve the depth cameras among them with depth, for the driver `realsense`; otherwise all are webcams."""
    tactile: bool = False
    """Serve tactile sensors in the place of the gripper's pads, too."""

    def run(self) -> int:
        """Run the robot, or cause the fault."""
        verb, *rest = self.words or ("",)
        if verb == "tell":
            from rcs.virtual.control import tell

            if len(rest) < 2:
                raise InvalidSetup("`rcs virtual tell` takes the name of a running robot and a fault, such as: cut.")
            if answer := tell(rest[0], rest[1:]):
                print(answer)
            return 0
        if rest or not verb:
            raise InvalidSetup(f"The words are {' '.join(self.words)!r}; valid is one robot, or: tell NAME FAULT.")
        return self._serve(verb)

    def _serve(self, robot: str) -> int:
        from rcs.virtual.virtual_world import VirtualWorld, usual_setup

        setup = usual_setup(robot) if self.setup is None else read_setup(self.setup)
        if self.setup is not None and setup.robot != robot:
            raise InvalidSetup(f"The setup {self.setup} is for {setup.robot!r}, not for {robot!r}.")
        world = VirtualWorld(
            setup,
            address=self.address,
            seed=self.seed,
            log=self.log,
            cameras=self.cameras,
            depth=self.depth,
            tactile=self.tactile,
        )
        try:
            for number in (signal.SIGTERM, signal.SIGINT):
                signal.signal(number, lambda *_: world.end())
            print(json.dumps({"name": world.name, "site": world.site()}), flush=True)
            world.run()
        finally:
            world.close()
        return 0


def read_setup(path: Path) -> Setup:
    """Read a setup from a JSON file.

    Raises:
        InvalidSetup: The file cannot be read, or is that of no setup.
    """
    try:
        return Setup.from_json(json.loads(path.read_text("utf-8")))
    except (OSError, ValueError, RecursionError) as err:
        raise InvalidSetup(f"The setup {path} cannot be read: {err}.") from err
