"""`rcs teleop`: people lead robots with input devices."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rcs_data.cli.console import plain_console
from rich.console import Console

from rcs.agents import Agent, agent_for
from rcs.cli.setup_options import SetupOptions, recorded_cameras
from rcs.envs.env import Env
from rcs.envs.observers.record import record
from rcs.envs.observers.twin import attach_twin
from rcs.errors import InvalidSetup
from rcs.rollout.interactive.session import playable
from rcs.rollout.latency import Latency
from rcs.rollout.takes import Takes
from rcs.rollout.teleoperate import Teleoperation, without_figures
from rcs.setups.make import make
from rcs.teleop.device import InputDevice
from rcs.teleop.hand import LeadOptions
from rcs.teleop.leader import Leader
from rcs.teleop.operator import Operator, device_of
from rcs.teleop.takeover import Takeover, people_of


@dataclass(kw_only=True)
class TeleopCommand(SetupOptions):
    """Lead robots, simulated or real, with an input device, and record takes.

    The robot follows while the clutch is pressed, from where it is, and brakes whenever the device is silent. Buttons
    begin and judge takes. With `--agent`, that acts until you take over. Ctrl-C ends.
    """

    task: tyro.conf.Positional[str] = "Free"  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]
    """Name of the task, such as PickCuboid, or `module:Class`."""
    agent: str | None = None
    """Agent that acts until you take over: its name, `module:Class`, the path of a checkpoint, or the address of a
    policy; by default none, and you lead from the beginning."""
    input: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME[:ADDRESS]")] = ("keyboard",)
    """Device that leads, such as `keyboard` or `spacemouse:/dev/hidraw0`; the buttons of further ones count, too."""
    lead: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[HAND=ROBOT ...]")] = ()
    """The robot that each hand leads; by default those of the same name, or the only one."""
    hand: Annotated[LeadOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=LeadOptions)
    hardware: str | None = None
    """Real devices: the JSON file of a site, or `driver:address` for all arms with their end effectors."""
    record: Path | None = None
    """Folder of the dataset of takes; an existing one is continued, with a device that measures the same: poses,
    velocities or joints. Nothing is recorded by default."""
    instruction: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[TEXT ...]")] = ()
    """Instructions of the takes, in turn; by default that of the task."""
    torque: bool = False
    """Have the motors of a leader lead it gently after the robot while you do not lead; the device beside it is the
    clutch, such as a pedal, or any key of motion of a keyboard."""
    twin: bool = False
    """Have a digital twin beside the real robot of `--hardware`; an alarm makes all devices hold."""
    measure: bool = False
    """Measure the time from your hand to the command and to the first picture that has changed."""

    def run(self) -> int:
        """Lead until the button `stop`, Ctrl-C or SIGTERM."""
        console = plain_console(soft_wrap=False)
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            with ExitStack() as stack:
                self._lead(stack, console)
        except KeyboardInterrupt:
            pass
        finally:
            signal.signal(signal.SIGTERM, before)
        return 0

    def _lead(self, stack: ExitStack, console: Console) -> None:
        devices = self._devices()
        env = stack.enter_context(make(self._setup(), hardware=self.hardware))
        agent = self._agent(env, devices)
        stack.callback(agent.close)
        latency = None
        if self.measure:
            env.add_observer(latency := Latency())
        if self.twin:
            stack.enter_context(attach_twin(env, on_alarm="hold"))
        takes = None
        if self.record is not None:
            recorder = stack.enter_context(record(env, self.record, notes=agent.note_fields))
            takes = Takes(recorder, env.frequency, instructions=self.instruction, latency=latency)
        (operator,) = people_of(agent)
        operator.open()  # before the robots, so that a missing device is reported first
        loop = Teleoperation(env, agent, takes=takes, seed=self.seed, report=console.print)
        for device in devices:
            if device.instructions:
                console.print(device.instructions, soft_wrap=True)
        console.print(f"{' and '.join(self.input)} leads {', '.join(env.robots)}. Ctrl-C ends.", soft_wrap=True)
        states = _States(operator, console)
        try:
            loop.run(states.show)
        finally:
            console.print(f"Loop: {loop.statistics}", soft_wrap=True)
            console.print("; ".join([f"Readings: {operator.feed.readings}", *operator.left_out]), soft_wrap=True)
            if latency is not None:
                console.print(f"Latency of {self.input[0]}: {latency}", soft_wrap=True)
            if takes is not None:
                console.print(f"Dataset: {self.record}   ({takes.kept} takes kept)", soft_wrap=True)

    def _setup(self) -> Any:
        usual: dict[str, Any] = {}
        if self.record is not None or self.measure:
            usual["cameras"] = recorded_cameras(self.hardware)
        keep_gripper = self.checkpoint is not None or "binary_gripper" in self.given
        setup = playable(self.setup("realtime", **usual), keep_gripper=keep_gripper)
        return replace(setup, max_episode_steps=self.given.get("max_episode_steps"))

    def _devices(self) -> list[InputDevice]:
        """Return the device that leads, and those beside it."""
        if not self.input:
            raise InvalidSetup("No device is given; valid is one that leads, such as --input keyboard.")
        devices = [device_of(given) for given in self.input]
        if self.torque:
            leader = devices[0]
            if not isinstance(leader, Leader) or len(devices) < 2:
                raise InvalidSetup(
                    f"--torque with --input {' '.join(self.input)}; it is for a leader, and a device beside it has to "
                    "be the clutch, such as --input gello:gello.json pedal."
                )
            leader.has_torque = leader.has_clutch = True
        return devices

    def _agent(self, env: Env, devices: Sequence[InputDevice]) -> Agent:
        robots = _pairs(self.lead)
        operator = Operator(env, devices[0], beside=devices[1:], options=self.hand, robots=robots)
        actor = self.actor
        if actor is None:
            return operator
        if not any(device.has_takeover for device in devices):
            given = " ".join(self.input)
            raise InvalidSetup(f"{given} cannot take over; put a keyboard beside it: --input {given} keyboard.")
        return Takeover(env, agent_for(env, actor), operator)


class _States:
    """Prints the state of the hands, and what is wrong, when one of them changes."""

    def __init__(self, operator: Operator, console: Console) -> None:
        self._operator, self._console, self._shown = operator, console, ""

    def show(self) -> bool:
        """Print what has changed; return False."""
        operator = self._operator
        states = ", ".join(f"{name} {state}" for name, state in operator.states.items())
        shown = f"{states}{f': {operator.problem}' if operator.problem else ''}"
        if (words := without_figures(shown)) != self._shown:
            self._console.print(shown, soft_wrap=True)
            self._shown = words
        return False


def _pairs(given: Sequence[str]) -> dict[str, str] | None:
    pairs = [one.partition("=") for one in given]
    if wrong := [one for one, (hand, sign, robot) in zip(given, pairs, strict=True) if not (hand and sign and robot)]:
        raise InvalidSetup(f"lead is {wrong[0]!r}; it is written as hand=robot, such as right=fr3.")
    return {hand: robot for hand, _, robot in pairs} or None
