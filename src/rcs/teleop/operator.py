"""The operator: a person who leads robots with a device, as an agent.

A thread reads the device; `act` takes its newest reading and never waits. Whatever the device does or stops doing, the
robots brake and stay from the first action after `valid_for` on. Whatever the loop does or stops doing, the deadlines
of the devices' commands hold real robots.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from rcs.agents.agent import ACTOR, Agent, Event
from rcs.agents.guide import Guide
from rcs.devices import lookup
from rcs.envs.env import Env
from rcs.envs.observer import Note
from rcs.envs.spaces import Action, Observation
from rcs.envs.step.stack import for_all
from rcs.errors import InvalidSetup, UnknownName
from rcs.teleop.device import InputDevice
from rcs.teleop.feed import REQUESTS, Feed, News, with_buttons
from rcs.teleop.hand import Hand, LeadOptions, State
from rcs.teleop.pedal import Pedal

LEAST_RATE = 20.0
"""Lowest rate of an environment that a person leads in [Hz]: silence is seen up to a period late, and commands to real
arms expire after three."""

HELD_UP = 0.3
"""Time between two actions after which hands are held [s]: real arms have stopped by then, and the hands are
elsewhere."""

STATES: tuple[State, ...] = ("released", "engaged", "held")
UNITS = {"pose": "m, xyzw", "twist": "m/s, rad/s", "joints": "rad"}
"""Units of what a device measures."""


class Operator(Agent):
    """Leads the robots of an environment as the hands of a person move."""

    def __init__(
        self,
        env: Env,
        device: InputDevice | str,
        *,
        beside: Sequence[InputDevice | str] = (),
        options: LeadOptions | None = None,
        robots: Mapping[str, str] | None = None,
        clock: Callable[[], float] = time.monotonic,
        has_thread: bool = True,
    ) -> None:
        """Prepare; nothing is connected and nothing moves.

        Args:
            env: The environment.
            device: The device, which the operator opens in `open`, or at the first `reset`, and closes; or the name of
                an entry point of `rcs.inputs`, or `module:Class`, with an address after another colon, if there is a
                choice, such as `spacemouse:/dev/hidraw0`.
            beside: Devices that give only their buttons, such as a pedal, or a keyboard to judge takes. Their clutch
                does not count, which is any key of motion of a keyboard, but that of a pedal is then the only one; so
                is that of the first device beside a leader with torque.
            options: Scale, direction, smoothing and speeds; None for the usual ones.
            robots: The robot that each hand leads, by the name of the hand; None for hands and robots of the same name,
                or for the only robot and the right hand. Robots that no hand leads stay where they are.
            clock: Returns the time of readings [s].
            has_thread: Whether a thread reads the device; see `Feed`.

        Raises:
            InvalidSetup: Steps are synchronous or too rare, hands do not fit the robots, the device's address makes no
                sense, or a layer has given a robot actions that only a policy can make.
            UnknownName: There is no robot, no hand, or no device of this name.
        """
        if env.setup.stepping == "sync":
            raise InvalidSetup("A person leads a robot step by step; use stepping='realtime', not 'sync'.")
        if env.frequency < LEAST_RATE:
            raise InvalidSetup(
                f"frequency is {env.frequency:g} Hz; valid for a person who leads is {LEAST_RATE:g} Hz or more, so "
                "that robots stop in time when the hand is lost. A policy may decide at a lower rate that divides it."
            )
        options = options or LeadOptions()
        self.device = device = device_of(device)
        """The device."""
        others = [device_of(one) for one in beside]
        self.devices = [device, *others]
        """All devices."""
        needs_clutch = device.motion[0] == "joints" and device.has_clutch
        self._beside = [
            (Feed(one), isinstance(one, Pedal) or (needs_clutch and at == 0)) for at, one in enumerate(others)
        ]
        self.feed = Feed(device, clock=clock, has_thread=has_thread)
        """The readings of the device."""
        self.news = News()
        """The newest reading, at the last action."""
        self._clock = clock
        self._events: list[Event] = []
        self._led = _robots_of(env, device, robots)
        self._guides = {
            name: Guide(env, robot, speed=options.speed, turn_speed=options.turn_speed)
            for name, robot in env.robots.items()
        }
        self._others = {name: guide for name, guide in self._guides.items() if name not in self._led.values()}
        has_clutch = device.has_clutch or any(is_clutch for _, is_clutch in self._beside)
        self._hands = {
            hand: Hand(self._guides[robot], options, period=1.0 / env.frequency, has_clutch=has_clutch)
            for hand, robot in self._led.items()
        }
        self._latency = np.nan
        self._polled: float | None = None

    @property
    def states(self) -> dict[str, State]:
        """The state of each hand."""
        return {name: hand.state for name, hand in self._hands.items()}

    @property
    def problem(self) -> str:
        """Why hands are held or do not engage, and what was left out, in words; empty if nothing is wrong."""
        words = [f"{name}: {hand.why}" for name, hand in self._hands.items() if hand.why]
        if self.news.reading is None and self.news.why:
            words = [self.news.why]
        return "; ".join([*words, *self.left_out])

    @property
    def left_out(self) -> list[str]:
        """Words on what was left out of the device's messages and how often; empty for nothing."""
        counts = sum((feed.left_out for feed, _ in self._beside), self.feed.left_out)
        text = ", ".join(f"{flaw} {number}" for flaw, number in counts.items())
        return [f"left out: {text}"] if text else []

    @property
    def note_fields(self) -> Sequence[Note]:
        """Fields that `notes` has, as `notes_of` gives them."""
        return notes_of(self.device, self._hands)

    def lead_only(self, robot: str) -> None:
        """Lead one robot of several; the others have agents of their own.

        Raises:
            InvalidSetup: No hand leads it.
        """
        if robot not in self._led.values():
            hand = next(iter(self._led))
            raise InvalidSetup(
                f"The hands lead {self._led}, and the person is to lead {robot!r}; name the robot of each hand, such "
                f"as robots={ {hand: robot} }."
            )

    def open(self) -> None:
        """Connect the devices, and begin to read them.

        Raises:
            DeviceFault: The device is not there, or may not be opened.
            InvalidSetup: Its address makes no sense.
            MissingDependency: A package is not installed.
        """
        try:
            for feed, _ in self._beside:
                feed.open()
            self.feed.open()
        except BaseException:
            self.close()
            raise

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Stay where the robots are, with what the grippers hold; the clutch has to be pressed anew."""
        self.open()
        self.take_over(observation, info)

    def take_over(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin from where another agent has led the robots; the clutch has to be pressed anew.

        Args:
            observation: The present observation.
            info: Info of the last step; grippers keep its target, so that nothing falls.
        """
        self._polled = None
        for guide in self._guides.values():
            guide.reset(observation)
        self.keep_opening(info)
        self.hold("press the clutch to lead")
        for guide in self._others.values():
            guide.brake()

    def keep_opening(self, info: Mapping[str, Any]) -> None:
        """Want the openings that a step commanded, as `Guide.keep_opening` does."""
        for guide in self._guides.values():
            guide.keep_opening(info)

    def hold(self, why: str) -> None:
        """Have all robots brake and stay, until the clutch was released and pressed.

        Args:
            why: The reason in words.
        """
        for hand in self._hands.values():
            hand.hold(why)

    def wait(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Take the person's requests while another agent acts; return no action."""
        self._poll()
        self.hold("another agent acts")
        self._show(observation, info)
        return {}

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the next action, from the newest reading."""
        now, news, reading = self._poll(), self.news, self.news.reading
        for name, pressed in news.pressed.items():
            shown = None if reading is None else reading.hands.get(name)
            if "front" in pressed and shown is not None and shown.is_tracked and shown.pose is not None:
                for hand in self._hands.values():  # whichever shows it, a person faces one front
                    hand.face(shown.pose)
        actions: dict[str, Action] = {name: guide.act(observation, info) for name, guide in self._others.items()}
        for name, hand in self._hands.items():
            actions[self._led[name]] = hand.act(
                observation,
                info,
                hand=None if reading is None else reading.hands.get(name),
                pressed=news.pressed.get(name, ()),
                broken=news.broken.get(name, "") if reading is not None else news.why,
                time=0.0 if reading is None else reading.time,
                now=now,
            )
        self._show(observation, info)
        return actions if len(actions) > 1 else next(iter(actions.values()))

    def notes(self) -> Mapping[str, Any]:
        """Return the notes of `note_fields`."""
        reading = self.news.reading
        notes: dict[str, Any] = {"actor": "person", "input_latency": self._latency}
        if reading is not None:
            notes["input_time"] = reading.time
            for name in self._hands:
                one, (kind, _) = reading.hands.get(name), self.device.motion
                if one is not None and one.is_tracked and (measured := getattr(one, kind)) is not None:
                    notes[f"{name}_{kind}"] = measured
        return {**notes, **{f"{name}_state": state for name, state in self.states.items()}}

    def events(self) -> Sequence[Event]:
        """Return the person's requests since the last call, oldest first."""
        events = self._events
        self._events = []
        return events

    def close(self) -> None:
        """End the threads and close the devices. Closing twice is harmless."""
        for_all([self.feed.close, *(feed.close for feed, _ in self._beside)])

    def _poll(self) -> float:
        """Ask for news, and return the present time [s]."""
        self.news = self.feed.poll()
        for feed, is_clutch in self._beside:
            self.news = with_buttons(self.news, feed.poll(), self.device.hands, is_clutch=is_clutch)
        now, reading = self._clock(), self.news.reading
        self._latency = np.nan if reading is None else now - reading.time
        before, self._polled = self._polled, now
        if before is not None and now - before > HELD_UP:
            self.hold(f"the loop was held up for {now - before:.1f} s; press the clutch anew")
        return now

    def _show(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Take the person's requests, and show what the robot does."""
        for buttons in (*self.news.pressed.values(), self.news.requests):
            self._events.extend(request for button in buttons for request in REQUESTS if request == button)
        for device in self.devices:
            device.feedback(observation, {**info, "operator": self.states, "led": self._led})


def notes_of(device: InputDevice | type[InputDevice], hands: Iterable[str] | None = None) -> list[Note]:
    """Return the notes of an operator: who acted, when hands were measured, how late; state and motion of each.

    Args:
        device: The device, or its class.
        hands: Names of the hands that lead; None for all that it has.
    """
    fields, (kind, size) = [ACTOR, Note("input_time", unit="s"), Note("input_latency", unit="s")], device.motion
    for name in device.hands if hands is None else hands:
        fields += [Note(f"{name}_state", words=STATES), Note(f"{name}_{kind}", size=size, unit=UNITS[kind])]
    return fields


def device_of(given: InputDevice | str) -> InputDevice:
    """Return the device that is given to an operator, maybe by its name; nothing is connected."""
    if isinstance(given, InputDevice):
        return given
    name, _, address = given.partition(":")
    if address and name not in lookup.names("input"):
        own, _, address = address.partition(":")
        name = f"{name}:{own}"
    made = lookup.find("input", name)(address or None)
    if not isinstance(made, InputDevice):
        raise InvalidSetup(f"The input device {name!r} makes {made!r}; valid is an InputDevice.")
    return made


def _robots_of(env: Env, device: InputDevice, given: Mapping[str, str] | None) -> dict[str, str]:
    """Return the robot that each hand leads, by hand."""
    if given is not None:
        for hand, robot in given.items():
            if hand not in device.hands:
                raise UnknownName("hand of the device", hand, device.hands)
            if robot not in env.robots:
                raise UnknownName("robot", robot, env.robots)
        if len(set(given.values())) < len(given) or not given:
            raise InvalidSetup(f"The hands lead {dict(given)}; each leads a robot of its own, at least one.")
        return dict(given)
    if len(env.robots) == 1:
        return {"right" if "right" in device.hands else device.hands[0]: next(iter(env.robots))}
    same = {hand: hand for hand in device.hands if hand in env.robots}
    if not same:
        raise InvalidSetup(
            f"The device has the hands {', '.join(device.hands)} and the robots are {', '.join(env.robots)}; name the "
            "robot that each hand leads, such as robots={'right': '" + next(iter(env.robots)) + "'}."
        )
    return same
