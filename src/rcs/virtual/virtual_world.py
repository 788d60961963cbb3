"""A virtual world: the scene of a setup, stepped in real time, with a wire for each of its robots.

Timing: one thread runs the loop. A tick is due every `1 / rate` seconds of the monotonic clock; late ticks are made up
at once, unless more than `LONGEST_GAP` has passed. Between ticks, the loop reads the wires' input.
"""

from __future__ import annotations

import gc
import json
import os
import select
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rcs.devices import lookup
from rcs.envs.assemble import compose
from rcs.envs.episode_random import EpisodeRandom, check_seed
from rcs.envs.setup import Setup
from rcs.envs.step.simulation import Simulation
from rcs.errors import InvalidSetup, UnknownName
from rcs.setups.lab import lab_of
from rcs.setups.make import resolve
from rcs.sim.world import World
from rcs.virtual.control import Control
from rcs.virtual.fault import GENERIC, Fault
from rcs.virtual.robot_log import RobotLog
from rcs.virtual.sensors import VirtualSensors
from rcs.virtual.virtual_robot import VirtualRobot
from rcs.virtual.wire import Wire

LONGEST_GAP = 0.25
"""Longest gap in time that is made up; longer ones are skipped, as if the world had stood still [s]."""
PRIORITY = 20
"""Real-time priority of the loop where the system permits one; below that of arms' threads."""

ABOUT, JUDGE, LOOK = "about", "judge", "look"
"""Questions: for name, site and setup as JSON; for success of the task since the objects were last placed; and for the
poses of the objects as JSON, now that somebody has placed them: from here on, success counts anew."""
VERDICTS: Mapping[bool | None, str] = {True: "done", False: "not done", None: "not known"}
"""Answers to `judge`; "not known" for tasks without a goal."""

AnyWire = Callable[[VirtualRobot, str], Wire]


class VirtualWorld:
    """The robots and objects of a setup, each robot behind the wire of its vendor."""

    def __init__(
        self,
        setup: Setup,
        *,
        address: str | None = None,
        seed: int = 0,
        log: Path | None = None,
        wires: Mapping[str, type[Wire]] | None = None,
        cameras: Sequence[str] = (),
        depth: bool = False,
        tactile: bool = False,
    ) -> None:
        """Place the robots at home and the objects according to the seed, and listen.

        Args:
            setup: The scene and its robots; frequency and layers are ignored, and so are cameras that are not named.
            address: Address of the first robot, None for the default; each further robot uses the next address.
            seed: Random seed of the objects' placement.
            log: Path of the log; None for none.
            wires: Wires by arm name, in addition to the installed ones.
            cameras: Names of cameras that are served, too.
            depth: True to serve the depth cameras among them with depth, for the driver `realsense`.
            tactile: True to serve tactile sensors in the place of the grippers' pads, DIGITs unless the setup says.

        Raises:
            UnknownName: There is no wire for an arm, or a name in the setup does not exist.
            InvalidSetup: An address is taken, or `depth` is True without cameras.
            OSError: The log cannot be written.
        """
        if depth and not cameras:
            raise InvalidSetup("depth is True and there are no cameras; name those to serve, or leave depth out.")
        kinds = {stand.name: _wire_of(stand.arm, wires or {}) for stand in lab_of(setup.robot).stands}
        self.rate = max(kind.rate for kind in kinds.values())
        """Ticks per second [Hz]."""
        setup = replace(setup, randomisation=None, compliance=None, physics_step=1.0 / self.rate)
        setup = replace(setup, tactile=(setup.tactile or "digit") if tactile else None)
        parts = resolve(replace(setup, cameras=_chosen(setup, cameras, depth)))
        self.world = World(compose(parts).compile(), frequency=self.rate)
        """The physics."""
        self.setup = parts.setup
        self.ticks = 0
        """Number of ticks so far."""
        self.late_ticks = 0
        """Number of ticks that began more than a period late."""
        dofs = {robot.name: robot.arm.dof for robot in parts.robots}
        self.log = RobotLog(log, dofs, rate=self.rate, setup=parts.setup.to_json())
        self.robots = {robot.name: VirtualRobot(self.world, robot, self.log) for robot in parts.robots}
        """The robots by name."""
        self._simulation = Simulation(self.world, [robot.body for robot in self.robots.values()], parts.task)
        self._judged_every = max(1, round(self.rate / parts.setup.frequency))
        self.success: bool | None = None
        """True if the task has been done since the objects were placed; None for a task without a goal."""
        self._is_ended = False
        self.wires: dict[str, Wire] = {}
        """The wires by robot."""
        self.hands: dict[str, tuple[str, Wire]] = {}
        """Robots and wires of hands that have one of their own, by `hand`, or `robot_hand` of several robots."""
        self.control: Control | None = None
        self.sensors: VirtualSensors | None = None
        """The cameras and tactile sensors that are served."""
        self.reset(seed)
        for robot in self.robots.values():
            robot.rest()
        try:
            for name, kind in kinds.items():
                address = kind.address if address is None else address
                self.wires[name] = kind(self.robots[name], address)
                address = kind.next_address(address)
                hand = self.robots[name].body.placement.hand
                if hand is not None and hand.name in lookup.names("wire"):
                    label = "hand" if len(kinds) == 1 else f"{name}_hand"
                    self.hands[label] = (name, _wire_of(hand.name, wires or {})(self.robots[name], ""))
            if cameras or tactile:
                self.sensors = VirtualSensors(self.world, self.setup, parts.tactile)
            robot = setup.robot
            self.control = Control(robot if isinstance(robot, str) else "-".join(robot))
        except BaseException:
            self.close()
            raise

    @property
    def name(self) -> str:
        """Name for sending faults to it."""
        assert self.control is not None
        return self.control.name

    def site(self) -> dict[str, dict[str, Any]]:
        """Return the site of its robots and sensors in the format of a site file."""
        site: dict[str, dict[str, Any]] = {}
        for name, wire in self.wires.items():
            for kind, entry in wire.site().items():
                site.setdefault(kind, {})[name] = dict(entry)
        for name, wire in self.hands.values():
            for kind, entry in wire.site().items():
                site.setdefault(kind, {})[name] = dict(entry)
        return site if self.sensors is None else {**site, **self.sensors.site()}

    def reset(self, seed: int, episode: int = 0) -> None:
        """Place the objects like a reset with a seed; the robots stay in place.

        Args:
            seed: Seed of the environment.
            episode: Number of episodes since the seed was set.

        Raises:
            InvalidSetup: The seed is invalid.
        """
        random = EpisodeRandom(np.asarray(check_seed(seed)), np.asarray(episode))
        kept = [
            (array, at, array[at].copy())
            for robot in self.robots.values()
            for array, at in (
                (self.world.qpos, robot.body.layout.qpos),
                (self.world.qvel, robot.body.layout.qvel),
                (self.world.qpos, robot.body.layout.finger_qpos),
                (self.world.qvel, robot.body.layout.finger_qvel),
            )
        ]
        controls = self.world.ctrl.copy()
        self._simulation.begin(random)
        for array, at, values in kept:
            array[at] = values
        self.world.ctrl[...] = controls
        self.world.refresh()
        self.success = None

    def _judge(self) -> None:
        """Check whether the task is done, like an environment after each step."""
        success = self._simulation.evaluate().success
        if success is not None:
            self.success = bool(self.success) or bool(success)

    def tell(self, words: Sequence[str]) -> str:
        """Apply a fault or answer a question.

        Args:
            words: Name of the robot, "" for all robots, or name of a sensor, of which the end after `_` is enough if it
                is that of no other; then a fault and its value, or a question.

        Returns:
            The answer; empty for a fault.

        Raises:
            UnknownName: There is no such robot or sensor, or it has no such fault.
            InvalidSetup: The value is invalid; nothing happens then.
        """
        name, *rest = words
        sensors = self.sensors
        if sensors is not None and name not in ("", *self.robots, *self.hands) and (sensor := sensors.named(name)):
            sensors.tell(sensor, rest)
            self.log.note("", "told", sensor=sensor, fault=rest[0], value=" ".join(rest[1:]))
            return ""
        if name in self.hands:
            robot, wire = self.hands[name]
            fault = Fault.parse(rest, {**wire.faults, "clear": ""})
            wire.clear() if fault.name == "clear" else wire.tell(fault)
            self.robots[robot].note("told", hand=name, fault=fault.name, value=fault.value)
            return ""
        if name and name not in self.robots:
            more = () if sensors is None else sensors.names
            raise UnknownName("robot, hand or sensor of this world", name, [*self.robots, *self.hands, *more])
        if rest == [JUDGE]:
            self._judge()
            return VERDICTS[self.success]
        if rest == [LOOK]:
            self.success = None
            return json.dumps({one: pose.tolist() for one, pose in self._simulation.object_poses().items()})
        if rest == [ABOUT]:
            return json.dumps({"name": self.name, "site": self.site(), "setup": self.setup.to_json()})
        names = [name] if name else list(self.robots)
        faults = {one: Fault.parse(rest, {**GENERIC, **self.wires[one].faults}) for one in names}
        for one, fault in faults.items():
            self._befall(self.robots[one], self.wires[one], fault)
            self.robots[one].note("told", fault=fault.name, value=fault.value)
        return ""

    def _befall(self, robot: VirtualRobot, wire: Wire, fault: Fault) -> None:
        if fault.name in wire.faults:
            wire.tell(fault)
        elif fault.name == "freeze":
            robot.frozen_until = time.monotonic() + fault.number
        elif fault.name == "push":
            robot.press(fault.force)
        elif fault.name == "reset":
            self.reset(int(fault.number))
        elif fault.name == "clear":
            robot.frozen_until = 0.0
            robot.press(np.zeros(3))
            robot.line.clear()
            wire.clear()
            for name, hand in self.hands.values():
                if name == robot.name:
                    hand.clear()
        else:
            robot.line.tell(fault)

    def run(self) -> None:
        """Step in real time until `end` is called."""
        with _undisturbed():
            period, due = 1.0 / self.rate, time.monotonic()
            while not self._is_ended:
                self._listen(due)
                began = time.monotonic()
                self._tick(due, began)
                due += period
                if began - due > LONGEST_GAP:
                    self.log.note("", "gap", seconds=began - due)
                    due = began

    def end(self) -> None:
        """Make `run` return; callable from signal handlers and any thread."""
        self._is_ended = True

    def close(self) -> None:
        """Release all addresses and files; closing twice is harmless."""
        for wire in (*self.wires.values(), *(one for _, one in self.hands.values())):
            wire.close()
        if self.control is not None:
            self.control.close()
        if self.sensors is not None:
            self.sensors.close()
        self.log.note("", "end", ticks=self.ticks, late=self.late_ticks)
        self.log.close()
        self.world.close()

    def _tick(self, due: float, began: float) -> None:
        self.ticks += 1
        self.late_ticks += began - due > 1.0 / self.rate
        for name, robot in self.robots.items():
            robot.line.flush()
            if not robot.is_frozen:
                self.wires[name].tick(robot)
            robot.settle()
        for name, wire in self.hands.values():
            wire.tick(self.robots[name])
        self.world.advance()
        if self.sensors is not None:
            self.sensors.show()
        if self.ticks % self._judged_every == 0:
            self._judge()
        for robot in self.robots.values():
            robot.log_tick(due, began)
        self.log.flush(began)

    def _listen(self, until: float) -> None:
        """Read input, at least once, until a time of the monotonic clock [s]."""
        assert self.control is not None
        while True:
            heard: dict[Any, Wire] = {}
            for name, wire in self.wires.items():
                if not self.robots[name].is_frozen:
                    heard.update(dict.fromkeys(wire.files(), wire))
            for _, wire in self.hands.values():
                heard.update(dict.fromkeys(wire.files(), wire))
            rest = max(until - time.monotonic(), 0.0)
            ready, _, _ = select.select([self.control.socket, *heard], [], [], self._wait(rest))
            for file in ready:
                if file is self.control.socket:
                    self.control.answer(self.tell)
                else:
                    heard[file].receive(file)
            for robot in self.robots.values():
                robot.line.flush()
            if self._is_ended or time.monotonic() >= until:
                return

    def _wait(self, rest: float) -> float:
        due = [one for robot in self.robots.values() if (one := robot.line.next_due) is not None]
        return min([rest, *(max(one - time.monotonic(), 0.0) for one in due)])


@contextmanager
def _undisturbed() -> Generator[None]:
    """Keep garbage collection, and other threads where permitted, from delaying this one."""
    gc.collect()
    gc.freeze()
    gc.disable()  # it takes longer than a tick
    usual, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    try:
        yield
    finally:
        os.sched_setscheduler(0, usual | os.SCHED_RESET_ON_FORK, parameters)  # only root may clear that flag
        gc.enable()


def usual_setup(robot: str) -> Setup:
    """Return the default setup of a virtual robot, with the first of the default tasks that suits it.

    Raises:
        UnknownName: There is no such robot.
    """
    lab = lab_of(robot)
    if lab.end_effector is None:
        return Setup(task="Free", robot=robot)
    if len(lab.stands) > 1:
        return Setup(task="LiftBar", robot=robot)
    return Setup(task="PickCuboid" if lab.end_effector in lookup.names("gripper") else "PickToy", robot=robot)


def _chosen(setup: Setup, cameras: Sequence[str], depth: bool) -> Any:
    """Return the cameras of a setup, or those of its lab, that are named."""
    mounts = {name: mount for name, mount in setup.cameras.mounts.items() if name in cameras}
    return (
        replace(setup.cameras, names=tuple(cameras), mounts=mounts, depth=depth, points=False, pixels=None)
        if cameras
        else ()
    )


def _wire_of(arm: str, wires: Mapping[str, type[Wire]]) -> type[Wire]:
    if arm in wires:
        return wires[arm]
    found = lookup.find("wire", arm)
    if not (isinstance(found, type) and issubclass(found, Wire)):
        raise InvalidSetup(f"The wire of {arm!r} is {found!r}; valid is a subclass of rcs.virtual.Wire.")
    return found
