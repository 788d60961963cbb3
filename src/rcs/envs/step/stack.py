"""The chains of all robots of an environment side by side, and the gates between them and the devices."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np
from gymnasium import spaces

from rcs.envs.gates.gate import Gate
from rcs.envs.layers.layer import CopyIndex, Layer
from rcs.envs.ports.port import Port, is_streamed
from rcs.envs.spaces import Action, Observation
from rcs.envs.step.chain import Chain, merged
from rcs.errors import InvalidAction, InvalidSetup, Refused, UnknownName

NAMELESS = ""
"""Name of the chain whose keys stay at the top: that of a robot alone, or of what several robots share."""

Nested = dict[str, dict[str, Any]]
"""Actions or observations by chain."""


class Stack:
    """Chains by name, and the verbs of a step for all of them together.

    Inside, all values are by chain. Users see the keys of a robot one level down under its name; those of the nameless
    chain stay at the top.
    """

    def __init__(self, chains: Chain | Mapping[str, Chain], gates: Sequence[Gate] = ()) -> None:
        """Put chains side by side.

        Args:
            chains: The chain of the only robot, or those of several by name; "" is for their shared ports, such as
                cameras.
            gates: Every action passes them, in this order.

        Raises:
            InvalidSetup: A robot has the name of a key that the robots share.
        """
        self.chains: dict[str, Chain] = {NAMELESS: chains} if isinstance(chains, Chain) else dict(chains)
        self.gates = list(gates)
        self._robots = [name for name in self.chains if name != NAMELESS]
        shared = self.chains.get(NAMELESS) or Chain([])
        self._shared_actions = shared.action_spaces
        if clash := sorted(set(self._robots) & {*shared.action_spaces, *shared.observation_spaces}):
            raise InvalidSetup(f"A robot is named {clash[0]!r}, which is a key of all robots; give it another name.")
        self.action_space = _space({name: chain.action_spaces for name, chain in self.chains.items()})
        self.observation_space = _space({name: chain.observation_spaces for name, chain in self.chains.items()})
        self.executed_spaces = _space({name: chain.executed_spaces for name, chain in self.chains.items()}).spaces
        """Spaces of the targets that the ports take."""
        named = [(name, port) for name, chain in self.chains.items() for port in chain.ports]
        self._ports = [(_prefix(name), port) for name, port in named]
        self._commanded = sorted(named, key=lambda one: one[1].joint_space is None)
        """Arms first, right after one another, so that several move together."""
        self._fallible = [(prefix, port) for prefix, port in self._ports if port.can_fail]
        self._aged = [(prefix, port) for prefix, port in self._ports if type(port).ages is not Port.ages]
        self._measured: Nested = {name: {} for name in self.chains}
        self._executed: Nested = self._measured
        self._target: Nested = self._measured

    @property
    def ports(self) -> list[Port]:
        """All ports, those of the robots first."""
        return [port for _, port in self._ports]

    @property
    def about(self) -> dict[str, dict[str, Any]]:
        """Facts about sensors for datasets: `cameras` (options, calibrations) and `labels` (names in segmentation)."""
        return reduce(merged, (port.about for port in self.ports), dict[str, Any]())

    @property
    def device_facts(self) -> dict[str, dict[str, Any]]:
        """Facts that open devices report, for episodes: `cameras` (serial numbers, calibrations of their own)."""
        return reduce(merged, (port.device_facts for port in self.ports), dict[str, Any]())

    @property
    def layers(self) -> list[Layer]:
        """All layers, chain by chain, from the lowest to the highest."""
        return [layer for chain in self.chains.values() for layer in chain.layers]

    @property
    def timed(self) -> list[str]:
        """Keys of `capture_times`, such as `frames/wrist` and `joints`."""
        return [prefix + key for prefix, port in self._ports for key in port.timed]

    @property
    def device_timed(self) -> list[str]:
        """Keys of `device_times`."""
        return [
            prefix + key
            for prefix, port in self._ports
            if port.freshness is not None or type(port).device_times is not Port.device_times
            for key in port.timed
        ]

    @property
    def executed(self) -> dict[str, Any]:
        """The last targets that the ports were sent, in the form of an action."""
        return self._squeeze(self._executed)

    @property
    def target(self) -> dict[str, Any]:
        """The targets of the last action on the highest level: absolute, and cut where a layer has cut them."""
        return self._squeeze(self._target)

    def map(self, action: Any) -> Nested:
        """Check the action and map it down; no device sees it, and no layer remembers it.

        Raises:
            InvalidAction: The action, or that of one robot, is not valid.
        """
        if not self._robots:
            return {NAMELESS: self.chains[NAMELESS].map(action)}
        robots = [name for name in self._robots if self.chains[name].action_spaces]
        if not isinstance(action, Mapping) or action.keys() != {*robots, *self._shared_actions}:
            given = sorted(map(str, action)) if isinstance(action, Mapping) else type(action).__name__
            raise InvalidAction(f"Expected one action per robot, {sorted(robots)}; got {given}.")
        mapped: Nested = {}
        for name, chain in self.chains.items():
            given = {key: action[key] for key in chain.action_spaces} if name == NAMELESS else action.get(name, {})
            try:
                mapped[name] = chain.map(given)
            except InvalidAction as err:
                raise InvalidAction(f"Robot {name!r}: {err}") from err
        return mapped

    def admit(self, mapped: Nested) -> Nested:
        """Return the targets that the gates let through.

        Raises:
            Refused: A gate refuses, or its deadline has passed.
        """
        if not self.gates:
            return mapped
        targets: Mapping[str, Action] = mapped
        measured = self.measure_devices()
        for gate in self.gates:
            start = time.perf_counter()
            answer = gate.admit(targets, measured)
            taken = time.perf_counter() - start
            if not taken <= gate.deadline:
                raise Refused(
                    f"{gate} answered after {1e3 * taken:.1f} ms; its deadline is {1e3 * gate.deadline:g} ms."
                )
            targets = self._checked(gate, answer, targets, measured)
        return {name: dict(targets[name]) for name in self.chains}

    def _checked(
        self, gate: Gate, answer: Any, given: Mapping[str, Action], measured: Mapping[str, Observation]
    ) -> Nested:
        """Return the answer of a gate, once it is found to be as valid as the targets that the gate was given.

        An arm that was found outside its range may be sent as far out as it is, as it was when layers last saw it, or
        as it was sent before.

        Raises:
            Refused: A robot or key is missing or unknown, or a value has another shape, is no number or out of bounds.
        """
        robots = {name for name, chain in self.chains.items() if chain.executed_spaces}
        if not isinstance(answer, Mapping) or not robots <= answer.keys() <= self.chains.keys():
            got = sorted(map(str, answer)) if isinstance(answer, Mapping) else type(answer).__name__
            raise Refused(f"{gate} returned {got}; valid are the targets of {sorted(robots)}.")
        checked: Nested = {}
        for name, chain in self.chains.items():
            own = answer.get(name, {})
            try:
                valid = chain.check_executed(own, measured[name], self._measured[name], self._executed[name])
            except InvalidAction as err:
                raise Refused(f"{gate} returned what {name or 'the robot'} cannot be sent: {err}") from err
            # A value that a gate leaves alone stays the same array, by which layers know it.
            checked[name] = {k: own[k] if own[k] is given[name].get(k) else value for k, value in valid.items()}
        return checked

    def send(self, mapped: Nested) -> None:
        """Set the targets of all devices and pass them up through the layers; nothing moves yet."""
        self.lead(mapped)
        self._target = {name: chain.map_executed(mapped[name]) for name, chain in self.chains.items()}

    def lead(self, targets: Nested) -> None:
        """Set the targets of all devices past the layers, which must be reset afterwards; an arm may have `joints`."""
        self._command(targets)
        self._executed = targets
        for gate in self.gates:
            gate.sent(targets)

    def repeat(self) -> None:
        """Set the last targets of all devices once more; layers and gates need not know."""
        self._command(self._executed)

    def _command(self, targets: Nested) -> None:
        for name, port in self._commanded:
            port.command(targets[name])

    def stay(self) -> None:
        """Hold all devices, and have the layers take what they then do for the targets of the last action."""
        self.hold()
        self._executed = self.at_rest()
        self._target = {name: chain.map_executed(self._executed[name]) for name, chain in self.chains.items()}

    def at_rest(self) -> Nested:
        """Return the targets with which arms stay where they are measured now, and grippers keep their last one."""
        measured = self.measure_devices()
        return {name: chain.at_rest(measured[name]) for name, chain in self.chains.items()}

    def measure(self) -> Nested:
        """Return the observations of the lowest level."""
        self._measured = {name: chain.measure() for name, chain in self.chains.items()}
        return self._measured

    def measure_devices(self) -> Nested:
        """Return the last observations with everything that takes commands measured anew."""
        measured = {name: dict(own) for name, own in self._measured.items()}
        for name, chain in self.chains.items():
            for port in chain.ports:
                if port.action_spaces:  # a port that only observes, such as a camera, need not be read for this
                    measured[name].update(port.observe())
        return measured

    def lift(self, measured: Nested) -> Observation:
        """Map the observations of the lowest level up through all layers, into the form that users see."""
        return self._squeeze({name: chain.lift(measured[name]) for name, chain in self.chains.items()})

    def reset(self, measured: Nested, where: CopyIndex) -> None:
        """Start episodes of some copies in all layers and gates, with the lowest level's observations."""
        for name, chain in self.chains.items():
            chain.reset(measured[name], where)
        for gate in self.gates:
            gate.reset(measured, where)

    def rebase(self, robot: str | None = None) -> None:
        """Make the devices and layers of one robot, or of all, continue from the measured state.

        Raises:
            UnknownName: There is no robot of this name.
        """
        if robot is not None and robot not in self._robots:
            hint = "" if self._robots else "This environment has one robot; call rebase()."
            raise UnknownName("robot", robot, self._robots, hint=hint)
        own = [name for name in self.chains if robot in (None, name)]
        for name in own:
            for port in self.chains[name].ports:
                port.rebase()
        measured = self._measured = self.measure_devices()
        for name in own:
            self.chains[name].rebase(measured[name])
        for gate in self.gates:
            gate.rebase({name: measured[name] for name in own})

    def faults(self) -> dict[str, str]:
        """Return the reason of every device that is in its fault state, by the device's name or `robot/device`."""
        return {prefix + key: why for prefix, port in self._fallible for key, why in port.faults().items()}

    def ages(self) -> dict[str, Any]:
        """Return the age of deliberately late observations in simulated time [s], by key."""
        return {prefix + key: age for prefix, port in self._aged for key, age in port.ages().items()}

    def info(self) -> dict[str, Any]:
        """Return the info of layers and gates about the last action; of several robots' layers, `robot/key`."""
        info: dict[str, Any] = {}
        for name, chain in self.chains.items():
            for layer in chain.layers:
                if own := layer.info():
                    info.update({f"{name}/{key}": value for key, value in own.items()} if name else own)
        for gate in self.gates:
            info.update(gate.info())
        return info

    def capture_times(self) -> dict[str, float]:
        """Return when each sensor was last read [s, monotonic clock], by its key such as `frames/wrist`."""
        return {prefix + key: when for prefix, port in self._ports for key, when in port.capture_times().items()}

    def device_times(self) -> dict[str, float]:
        """Return the same on the devices' own clocks [s], by key; NaN for devices without one."""
        return {prefix + key: when for prefix, port in self._ports for key, when in port.device_times().items()}

    def reconnections(self) -> dict[str, int]:
        """Return how often devices were connected again since `open`, by key, where they were."""
        return {prefix + key: n for prefix, port in self._ports for key, n in port.reconnections().items()}

    def clamped(self) -> dict[str, Mapping[str, int]]:
        """Return how many commands since `open` streamed arms carried out only in part, by arm and by quantity."""
        arms = [port.device for port in self.ports]
        return {arm.name: arm.clamped() for arm in arms if is_streamed(arm)}

    def open(self) -> None:
        """Connect all devices; where one fails, none stays open."""
        try:
            for port in self.ports:
                port.check()
            for port in self.ports:
                port.open()
        except BaseException as err:
            try:
                self.close()
            except Exception as also:  # noqa: BLE001  why a device could not be opened is the error to be raised
                err.add_note(f"While the other devices were closed: {type(also).__name__}: {also}")
            raise

    def hold(self) -> None:
        """Make every device stay where it is, also when one of them fails to."""
        for_all([port.hold for port in self.ports])

    def recover(self) -> None:
        """Clear the faults of all devices, also when one of them fails to; nothing moves."""
        for_all([port.recover for port in self.ports])

    def close(self) -> None:
        """Close all ports, also when one of them fails to."""
        for_all([port.close for port in self.ports])

    def _squeeze(self, nested: Nested) -> dict[str, Any]:
        """Return values by chain in the form that users see."""
        if not self._robots:
            return nested[NAMELESS]
        return {**{name: nested[name] for name in self._robots}, **nested.get(NAMELESS, {})}

    def __str__(self) -> str:
        """Return the gates, then chain after chain from top to bottom."""
        lines = [f"  gate: {gate}" for gate in self.gates]
        for name, chain in self.chains.items():
            lines += [f"  {name}:"] if name else []
            lines += [str(chain)] if chain.ports else []
        return "\n".join(lines)


def _prefix(name: str) -> str:
    return f"{name}/" if name else ""


def _space(boxes: Mapping[str, Mapping[str, spaces.Space[Any]]]) -> spaces.Dict:
    named: dict[str, spaces.Space[Any]] = {name: spaces.Dict(dict(own)) for name, own in boxes.items() if name and own}
    return spaces.Dict({**named, **boxes.get(NAMELESS, {})})


def for_all(calls: Sequence[Callable[[], None]]) -> None:
    """Make every call, whatever fails, and raise the first failure in the end with a note of the others.

    A call that Ctrl-C interrupts is made again: holding or closing a device must not end half way.

    Args:
        calls: Each is harmless when made twice.
    """
    failures: list[BaseException] = []
    for call in calls:
        for _ in range(2):
            try:
                call()
            except KeyboardInterrupt as err:
                failures.append(err)
                continue
            except BaseException as err:  # noqa: BLE001  every device gets its chance; the failure is raised below
                failures.append(err)
            break
    if failures:
        # An error that `except Exception` must not catch goes first.
        first = next((err for err in failures if not isinstance(err, Exception)), failures[0])
        for err in failures:
            if err is not first:
                first.add_note(f"After that, or before: {type(err).__name__}: {err}")
        raise first


def copied(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return arrays, in any nesting, that are the caller's own."""
    return {key: value.copy() if type(value) is np.ndarray else copied(value) for key, value in values.items()}
