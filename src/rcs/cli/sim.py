"""`rcs sim`: an environment to look at and to lead by hand, on a page in the browser."""

from __future__ import annotations

import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rcs_data.cli.console import plain_console

from rcs.cli.setup_options import SetupOptions
from rcs.errors import InvalidSetup
from rcs.rollout.interactive.browser_view import BrowserView
from rcs.rollout.interactive.session import Session, playable
from rcs.teleop import Operator


@dataclass(kw_only=True)
class SimCommand(SetupOptions):
    """Look at an environment and lead its robots by hand, on a page in the browser.

    The page has a target to drag for every robot, sliders, and the pictures of the cameras. Time passes as on the wall
    clock. With `--agent`, or a checkpoint in place of the task, that acts instead. One page leads, others show; when it
    is closed, the robots stay. With `--record`, its buttons begin and judge takes. Ctrl-C ends it.
    """

    agent: str | None = None
    """Agent that acts in your place: its name, `module:Class`, which is called with the environment, the path of a
    checkpoint, or the address of a policy. By default there is none, and the page can have the task's expert act."""
    host: str = "127.0.0.1"
    """Address at which the page is served; 0.0.0.0 lets other machines in, over TLS and with a code."""
    port: int = 8080
    """Port of the page, or the next one that is free; 0 for any."""
    hardware: str | None = None
    """Real devices: the JSON file of a site, or `driver:address` for all arms with their end effectors."""
    input: str | None = None
    """Input device that leads in place of the page, as of `rcs teleop`."""
    record: Path | None = None
    """Folder of the dataset of takes; an existing one is continued. Nothing is recorded by default."""
    instruction: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[TEXT ...]")] = ()
    """Instructions of the takes, in turn; by default that of the task."""
    paused: bool = False
    """Begin without letting time pass."""

    def run(self) -> int:
        """Simulate until Ctrl-C or SIGTERM."""
        if not 0 <= self.port <= 65535:
            raise InvalidSetup(f"port is {self.port}; valid is 0 (any) to 65535.")
        if self.input is not None and self.agent is not None:
            raise InvalidSetup("Both a device and an agent are to act; `rcs teleop` has you take over from an agent.")
        setup, given = self.setup(), self.input
        actor: Any = self.actor if given is None else lambda env: Operator(env, given)
        session = Session(
            playable(setup, keep_gripper=self.actor is not None),
            seed=self.seed,
            agent=actor,
            hardware=self.hardware,
            record_into=self.record,
            instructions=self.instruction,
        )
        session.is_playing = not self.paused
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            with session:
                if actor is not None:
                    session.let_agent(True)
                with BrowserView(session, host=self.host, port=self.port) as view:
                    plain_console().print(f"Open {view.url} in a browser. Ctrl-C ends.")
                    view.run()
        except KeyboardInterrupt:
            pass
        finally:
            signal.signal(signal.SIGTERM, before)
        return 0
