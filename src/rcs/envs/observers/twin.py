"""A digital twin: a simulation that gets the targets of a robot in real time, beside what the robot measures.

Time: targets count from when they were sent, measurements from when they were made, both on the host's monotonic clock.
The twin is brought up to each measurement and then compared; it needs no rate of its own.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rcs.envs.env import Env
from rcs.envs.observer import Observer, Transition
from rcs.envs.observers.in_background import InBackground
from rcs.envs.observers.tracking import Tracking
from rcs.envs.spaces import JOINTS, Arrays, Observation
from rcs.errors import InvalidSetup
from rcs.sim.scene import RobotPlacement
from rcs.sim.timed_world import LONGEST_GAP, SMOOTHING, TimedWorld

_log = logging.getLogger(__name__)

PHYSICS_STEP = 0.002
"""Time step of the twin's physics [s]."""

TOLERANCE = 0.01
"""By how much the lag may change without counting as an error [s]."""

OnAlarm = Literal["info", "hold"]
"""Effect of an alarm: it is in `info["twin"]`; with `hold`, all devices also enter their fault state and hold."""


@dataclass(frozen=True, kw_only=True)
class Alarm:
    """A robot that does not follow its targets."""

    robot: str
    """Its name."""
    joint: str
    """Name of the joint that is farthest off."""
    error: float
    """How far it is from where it should be, the lag taken into account [rad]."""
    time: float
    """When this was measured [s], on the monotonic clock."""

    def __str__(self) -> str:
        """Return the alarm in words."""
        return f"{self.robot}: {self.joint} is {self.error:.3f} rad from its twin"


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A robot beside its twin over the last seconds."""

    rms: NDArray[np.float64]
    """Root mean square of every joint's error [rad], (dof,), the lag taken out."""
    raw_rms: NDArray[np.float64]
    """The same with the lag left in."""
    lag: float | None
    """Time by which the robot comes after its twin [s]; None before there was enough motion."""
    error: NDArray[np.float64]
    """Present error of every joint [rad], (dof,), the lag taken out."""
    alarm: Alarm | None
    """The alarm of this episode."""
    measured: NDArray[np.float64]
    """Joints of the robot at its last measurement [rad], (dof,)."""
    expected: NDArray[np.float64]
    """Joints of the twin at that moment [rad], (dof,)."""


class Twin(Observer):
    """Follows robots with a simulation of them and measures how they differ; use it in `InBackground`.

    The lag of a robot is not an error: each measurement is compared with where the twin was about a lag ago. Before a
    lag is known, it may be any up to the longest.
    """

    def __init__(
        self,
        robots: Mapping[str, RobotPlacement],
        *,
        limit: float = 0.01,
        longest_lag: float = 0.1,
        smoothing: float = SMOOTHING,
        on_alarm: Callable[[Alarm], None] | None = None,
    ) -> None:
        """Simulate the robots in a scene of their own, without objects.

        Args:
            robots: The robots by name, as `env.robots` has them.
            limit: Error of a joint from which on there is an alarm [rad]. Lower is found earlier; above noise and sag.
            longest_lag: Longest lag of a healthy robot [s].
            smoothing: Time constant of each of the two low-passes through which the twin takes targets [s]; that of the
                robot's own driver. A robot that smooths less is ahead of its twin, which counts as an error.
            on_alarm: Called once per robot and episode, in the thread of the observer.

        Raises:
            InvalidSetup: A number is not positive, or there is no robot.
        """
        if not robots or not limit > 0:
            raise InvalidSetup(
                f"limit is {limit} rad, and there are {len(robots)} robots; valid are a positive limit, and at least "
                "one robot."
            )
        self.world = TimedWorld(list(robots.values()), physics_step=PHYSICS_STEP, smoothing=smoothing)
        """The simulation."""
        self._robots = dict(robots)
        self._limit = limit
        self._on_alarm = on_alarm
        self._tracking = {
            name: Tracking(robot.arm.dof, grid=PHYSICS_STEP, longest_lag=longest_lag) for name, robot in robots.items()
        }
        self._alarms: dict[str, Alarm] = {}
        self.comparisons: Mapping[str, Comparison] = {}
        """How every robot compares with its twin, after the last step; replaced as a whole, so any thread may read
        it."""

    def on_reset(self, first: Transition, seed: int | None) -> None:
        """Put the twin where the robots are."""
        self._alarms, self.comparisons = {}, {}
        self._start(first.time, self._joints_of(first.observation))

    def on_step(self, transition: Transition) -> None:
        """Bring the twin up to the measurements, and compare."""
        measured = self._joints_of(transition.observation)
        times = {name: self._time_of(name, transition) for name in self._robots}
        assert transition.executed is not None, "a step has executed targets"
        sent = transition.time if transition.command_time is None else transition.command_time
        for name, joints in self._joints_of(transition.executed).items():
            self.world.command(name, joints, at=sent)
        # Where robots stop that are held is their own; and a long pause is not simulated.
        if transition.after_hold or max(times.values()) - self.world.time > LONGEST_GAP:
            self._start(max(times.values()), measured)
        self.world.advance_to(max(times.values()), self._trace)
        before = dict(self._alarms)
        self.comparisons = {name: self._compare(name, times[name], measured[name]) for name in self._robots}
        for name, alarm in self._alarms.items():
            if name not in before:
                _log.warning("%s", alarm)
                if self._on_alarm is not None:
                    self._on_alarm(alarm)

    def info(self) -> Mapping[str, Any]:
        """Return `twin`: by robot, the last errors, lag and alarm in words, of the step before or an earlier one."""
        facts = {
            name: {
                "rms": one.rms,
                "lag": one.lag,
                "error": one.error,
                "alarm": "" if one.alarm is None else str(one.alarm),
            }
            for name, one in self.comparisons.items()
        }
        return {"twin": facts}

    def close(self) -> None:
        """Free the simulation."""
        self.world.close()

    def _start(self, time: float, measured: Mapping[str, NDArray[np.float64]]) -> None:
        self.world.start(time, measured)
        for name, tracking in self._tracking.items():
            tracking.start(time, measured[name])

    def _trace(self) -> None:
        for name, tracking in self._tracking.items():
            tracking.expect(self.world.time, self.world.arms[name].joints)

    def _compare(self, name: str, time: float, joints: NDArray[np.float64]) -> Comparison:
        tracking = self._tracking[name]
        tracking.measure(time, joints)
        lag = tracking.find_lag() if name not in self._alarms else tracking.lag
        around = (0.0, tracking.longest_lag) if lag is None else (lag - TOLERANCE, lag + TOLERANCE)
        error = tracking.deviation(*around)
        if error.max() > self._limit and name not in self._alarms:
            worst = int(error.argmax())
            joint = self._robots[name].arm.joints[worst]
            self._alarms[name] = Alarm(robot=name, joint=joint, error=float(error[worst]), time=time)
        return Comparison(
            rms=tracking.rms(lag or 0.0),
            raw_rms=tracking.rms(),
            lag=lag,
            error=error,
            alarm=self._alarms.get(name),
            measured=joints,
            expected=tracking.expected_at(np.array(time)),
        )

    def _joints_of(self, values: Observation | Arrays) -> dict[str, NDArray[np.float64]]:
        if len(self._robots) == 1 and JOINTS in values:
            return {next(iter(self._robots)): np.array(values[JOINTS])}
        return {name: np.array(values[name][JOINTS]) for name in self._robots}

    def _time_of(self, name: str, transition: Transition) -> float:
        times = transition.capture_times
        return times.get(f"{name}/{JOINTS}", times.get(JOINTS, transition.time))


@contextmanager
def attach_twin(
    env: Env, *, on_alarm: OnAlarm | Callable[[Alarm], None] = "info", limit: float = 0.01, longest_lag: float = 0.1
) -> Generator[Twin]:
    """Have a digital twin follow the robots of an environment, beside its loop.

    Args:
        env: An environment in real time, of real robots or stand-ins.
        on_alarm: `info`: `info["twin"]` has it. `hold`: besides, all devices enter their fault state, which ends the
            episode. Or a function, called in the thread of the twin.
        limit: Error of a joint from which on there is an alarm [rad], the lag taken out.
        longest_lag: Longest lag of a healthy robot [s].

    Yields:
        The twin, whose `comparisons` have errors and lag.

    Raises:
        InvalidSetup: The environment is not in real time, an option is not valid, or there are no devices to hold.

    Examples:
        >>> import rcs
        >>> with rcs.make("Free", hardware="sim") as env, rcs.attach_twin(env, on_alarm="hold") as twin:
        ...     observation, info = env.reset()
        ...     observation, *_, info = env.step(env.action_space.sample())
        ...     print(info["twin"])
    """
    if not env.is_real:
        raise InvalidSetup("A twin follows robots in real time; use hardware=..., or stepping='realtime'.")
    if any(
        chain.joint_space is not None and JOINTS not in chain.executed_spaces for chain in env.stack.chains.values()
    ):
        raise InvalidSetup(
            "A twin follows joint targets, and native=True leaves them to controllers; use native=False."
        )
    if isinstance(on_alarm, str) and on_alarm not in ("info", "hold"):
        raise InvalidSetup(f"on_alarm is {on_alarm!r}; valid: 'info', 'hold', or a function.")
    if on_alarm == "hold" and all(port.device is None for port in env.stack.ports):
        raise InvalidSetup("An alarm cannot make simulated robots hold; use hardware=..., or on_alarm='info'.")

    def hold_all(alarm: Alarm) -> None:
        for port in env.stack.ports:
            if port.device is not None:
                port.device.set_fault(f"twin: {alarm}")

    call = hold_all if on_alarm == "hold" else None if on_alarm == "info" else on_alarm
    twin = Twin(env.robots, limit=limit, longest_lag=longest_lag, on_alarm=call)
    observer = InBackground(twin)
    env.add_observer(observer)
    try:
        yield twin
    finally:
        env.remove_observer(observer)
        observer.close()
