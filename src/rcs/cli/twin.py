"""`rcs twin`: a robot beside its digital twin, live."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from rcs_data.cli.console import plain_console
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from rcs.agents import JointSweep
from rcs.cli.sim import ended_by_signals
from rcs.envs.env import Env
from rcs.envs.observers.twin import Comparison, OnAlarm, Twin, attach_twin
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.hardware.site import DeviceAddress, Site
from rcs.setups.make import make, resolve
from rcs.virtual.stand_in_arm import StandInArm

REFRESH = 0.25
"""Time between two looks at the figures [s]."""


@dataclass(kw_only=True)
class TwinCommand:
    """Sway a robot a little and show how it follows its digital twin: errors of the joints, lag, alarms.

    Without `--hardware`, a simulated robot with delay and noise stands in for the real one. With it, a real robot
    moves: every joint by `--amplitude` towards the middle of its range and back. Exit code 1 if there was an alarm.
    """

    robot: str = "fr3"
    """Name of the robot."""
    hardware: str | None = None
    """What is real: the path of a site file, or `driver:address`; a simulated stand-in when not given."""
    delay: float = 0.03
    """Delay of the stand-in [s]."""
    noise: float = 0.0005
    """Standard deviation of every joint that the stand-in measures [rad]."""
    freeze_after: float | None = None
    """Have the stand-in stop following after this time [s], to see the alarm."""
    amplitude: float = 0.3
    """How far each joint moves [rad]."""
    period: float = 3.0
    """Time for one way there and back of the first joint [s]."""
    frequency: float = 30.0
    """Control steps per second [Hz]."""
    seconds: float | None = None
    """How long to go on [s]; until Ctrl-C when not given."""
    limit: float = 0.01
    """Error of a joint from which on there is an alarm [rad]."""
    on_alarm: OnAlarm = "hold"
    """What an alarm does: `hold` has all devices hold and ends; `info` only tells."""
    browser: bool = False
    """Serve a page with the robot and its twin side by side."""
    host: str = "127.0.0.1"
    """Address at which the page is served; 0.0.0.0 lets everybody in the network in, without a password."""
    port: int = 8080
    """Port of the page, or the next one that is free; 0 for any."""

    def run(self) -> int:
        """Move the robot and show the figures; return the exit code."""
        console = plain_console(soft_wrap=False)
        setup = Setup(
            task="Free",
            robot=self.robot,
            relative="absolute",
            frequency=self.frequency,
            max_episode_steps=None,
        )
        hardware = self._stand_ins(setup) if self.hardware is None else self.hardware
        comparisons: Mapping[str, Comparison] = {}
        with make(setup, hardware=hardware) as env, attach_twin(env, on_alarm=self.on_alarm, limit=self.limit) as twin:
            with ended_by_signals(), self._page(env, twin, console) as show:
                self._sway(env, twin, console, show)
            comparisons = twin.comparisons
            console.print(figures(env, comparisons))
        return int(any(one.alarm is not None for one in comparisons.values()))

    def _stand_ins(self, setup: Setup) -> Site:
        if self.delay < 0 or self.noise < 0:
            raise InvalidSetup(f"delay is {self.delay} s and noise {self.noise} rad; valid are numbers from 0.")
        robots = resolve(setup).robots
        options = {"delay": self.delay, "noise": self.noise}
        mounted = {robot.name: {"gripper": robot.gripper.name} if robot.gripper else {} for robot in robots}
        arms = {name: DeviceAddress(driver="sim", options={**options, **more}) for name, more in mounted.items()}
        fake = DeviceAddress(driver="fake")
        return Site(
            arms=arms,
            grippers={robot.name: fake for robot in robots if robot.gripper is not None},
            hands={robot.name: fake for robot in robots if robot.hand is not None},
        )

    def _sway(self, env: Env, twin: Twin, console: Console, show: Any) -> None:
        agent = JointSweep(env, amplitude=self.amplitude, period=self.period)
        observation, info = env.reset()
        agent.reset(observation, info)
        begin = shown = time.monotonic()
        to_freeze = [port.device for port in env.stack.ports if isinstance(port.device, StandInArm)]
        with Live(console=console, auto_refresh=False, transient=True) as live:
            while self.seconds is None or time.monotonic() - begin < self.seconds:
                if self.freeze_after is not None and to_freeze and time.monotonic() - begin > self.freeze_after:
                    for device in to_freeze:
                        device.freeze()
                    to_freeze = []
                observation, _, terminated, truncated, info = env.step(agent.act(observation, info))
                if time.monotonic() - shown > REFRESH and twin.comparisons:
                    shown = time.monotonic()
                    live.update(figures(env, twin.comparisons), refresh=console.is_terminal)
                    show()
                if terminated or truncated:
                    break

    @contextmanager
    def _page(self, env: Env, twin: Twin, console: Console) -> Generator[Any]:
        with contextlib.ExitStack() as stack:
            if not self.browser:
                yield lambda: None
                return
            from rcs.rollout.interactive.twin_view import TwinView

            view = stack.enter_context(TwinView(env.robots, twin, host=self.host, port=self.port))
            console.print(f"Open {view.url} in a browser. Ctrl-C ends.")
            yield view.show


def figures(env: Env, comparisons: Mapping[str, Comparison]) -> RenderableType:
    """Return what is known of every robot and its twin, as tables."""
    shown: list[RenderableType] = []
    for name, one in comparisons.items():
        lag = "not known yet" if one.lag is None else f"{1e3 * one.lag:.1f} ms"
        table = Table(title=f"{name}: lag {lag}", title_justify="left")
        for column in ("joint", "RMS error [mrad]", "with lag [mrad]", "now [mrad]"):
            table.add_column(column, justify="left" if column == "joint" else "right")
        for joint, *values in zip(env.robots[name].arm.joints, one.rms, one.raw_rms, one.error, strict=True):
            table.add_row(joint, *(f"{1e3 * value:.2f}" for value in values))
        shown.append(table)
        shown.append(Text(f"ALARM  {one.alarm}" if one.alarm is not None else "no alarm"))
    return Group(*shown)
