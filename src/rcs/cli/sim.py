"""`rcs sim`: an environment to look at and to lead by hand, in a window or in the browser."""

from __future__ import annotations

import signal
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass

from rcs_data.cli.console import plain_console
from rich.console import Console

from rcs.cli.runs import ActorOptions
from rcs.errors import InvalidSetup
from rcs.rollout.interactive.session import Session, playable
from rcs.sim.viewer import has_display


@dataclass(kw_only=True)
class SimCommand(ActorOptions):
    """Look at a simulated environment and lead its robots by hand.

    Where there is a display, MuJoCo's own viewer opens; where there is none, or with `--browser`, a page to open in a
    browser, with a target to drag for every robot, sliders, and the pictures of the cameras. Time passes as on the
    wall clock. With `--agent`, or a checkpoint in place of the task, that acts instead. Ctrl-C ends it.
    """

    agent: str | None = None
    """Who acts in your place: the name of an agent, `module:Class`, which is called with the environment, or the path
    of a checkpoint. Nobody does by default, and the page can have the task's expert act."""
    browser: bool = False
    """Serve a page for the browser also where there is a display."""
    host: str = "127.0.0.1"
    """Address at which the page is served; 0.0.0.0 lets everybody in the network in, without a password."""
    port: int = 8080
    """Port of the page, or the next one that is free; 0 for any."""
    paused: bool = False
    """Begin without letting time pass."""

    def run(self) -> int:
        """Simulate until Ctrl-C, or until the window is closed."""
        if not 0 <= self.port <= 65535:
            raise InvalidSetup(f"port is {self.port}; valid is 0 (any) to 65535.")
        console = plain_console()
        in_browser = self.browser or not has_display()
        setup, actor = self.setup(), self.actor
        session = Session(playable(setup, keep_gripper=actor is not None), seed=self.seed, agent=actor)
        session.is_playing = not self.paused
        if actor is not None:
            try:
                session.let_agent(True)
            except BaseException:
                session.close()
                raise
        with ended_by_signals():
            if in_browser:
                self._serve(session, console)
            else:
                _show(session, console)
        return 0

    def _serve(self, session: Session, console: Console) -> None:
        from rcs.rollout.interactive.browser_view import BrowserView

        view = BrowserView(session, host=self.host, port=self.port)
        try:
            with view:
                console.print(f"Open {view.url} in a browser. Ctrl-C ends.")
                view.run()
        finally:
            view.session.close()


def _show(session: Session, console: Console) -> None:
    from rcs.rollout.interactive.window import Window

    with session, Window(session) as window:
        console.print(window.HELP)
        window.run()


@contextmanager
def ended_by_signals() -> Generator[None]:
    """Take Ctrl-C and SIGTERM for a wish to end, which is no error."""

    def on_termination(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, on_termination)
    try:
        yield
    except KeyboardInterrupt:
        pass
    finally:
        signal.signal(signal.SIGTERM, before)
