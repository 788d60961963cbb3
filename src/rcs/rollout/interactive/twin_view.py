"""A page in the browser with the measured robot, and beside it its twin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from rcs.envs.observers.twin import Twin
from rcs.rollout.interactive.page import Page, as_line
from rcs.sim.browser_scene import BrowserScene
from rcs.sim.scene import RobotPlacement
from rcs.sim.timed_world import TimedWorld

if TYPE_CHECKING:
    import viser

APART = 1.3
"""Distance between a robot and its twin as a share of its reach."""

BLUE = (0.13, 0.38, 0.85)
"""Colour of the twin."""

LEGEND = "Left: the measured robot. Right, in blue: its twin, the expected motion."


class TwinView(Page):
    """Serves robots and their twin to browsers; a context manager. One thread calls `show`."""

    def __init__(
        self, robots: Mapping[str, RobotPlacement], twin: Twin, *, host: str = "127.0.0.1", port: int = 8080
    ) -> None:
        """Prepare to serve; nothing is open yet.

        Args:
            robots: The robots by name.
            twin: Their twin.
            host: Address to listen at; the default is for this machine alone; others need the code of `url`.
            port: Port to listen at, or the next one that is free; 0 for any.
        """
        super().__init__(host, port)
        self._robots, self._twin = dict(robots), twin
        self._pictures: list[tuple[TimedWorld, BrowserScene]] = []
        self._text: Any = None

    def _build(self, server: viser.ViserServer) -> None:
        robots = list(self._robots.values())
        bases = np.array([robot.base_in_scene.translation for robot in robots])
        apart = APART * max(robot.arm.workspace_reach for robot in robots) + np.ptp(bases[:, 1])
        for name, side, tint in (("robot", -0.5, None), ("twin", 0.5, BLUE)):
            world = TimedWorld(robots)  # for this page alone, put where the robots are
            place = (0.0, side * apart, 0.0)
            scene = BrowserScene(server, world.world, robots, name=name, place=place, tint=tint)
            self._pictures.append((world, scene))
            server.scene.add_label(
                f"/{name}/label",
                name,
                position=(0.5 * apart, 0.0, 0.0),  # on the floor before it, from the scene's own origin
                font_screen_scale=1.6,
                anchor="center-center",
            )
        server.initial_camera.position = (2.4 * apart, 0.25 * apart, 0.8 * apart)  # the panel covers the right side
        server.initial_camera.look_at = (0.0, 0.25 * apart, 0.3 * apart)
        self._text = server.gui.add_markdown(f"{LEGEND}\n\nWaiting for the first step.")

    def show(self) -> None:
        """Show the present state of both."""
        comparisons = self._twin.comparisons
        if not comparisons:
            return
        for (world, scene), which in zip(self._pictures, ("measured", "expected"), strict=True):
            for name, one in comparisons.items():
                world.arms[name].put(getattr(one, which))
            scene.show()
        self._text.content = "\n\n".join([LEGEND, *(_words(name, one) for name, one in comparisons.items())])

    def close(self) -> None:
        """End the server. Closing twice is harmless."""
        super().close()
        for world, _ in self._pictures:
            world.close()
        self._pictures = []


def _words(name: str, one: Any) -> str:
    lag = "not known yet" if one.lag is None else f"{1e3 * one.lag:.0f} ms"
    alarm = "" if one.alarm is None else f"\n\n**Alarm: {as_line(one.alarm)}**"
    return f"**{as_line(name)}**: lag {lag}, largest RMS error {1e3 * one.rms.max():.1f} mrad{alarm}"
