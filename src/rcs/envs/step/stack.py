"""The chains of all robots of an environment side by side, and the gates between them and the devices."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from rcs.envs.gates.gate import Gate
from rcs.envs.layers.layer import Layer, Where
from rcs.envs.ports.port import Port, is_streamed
from rcs.envs.spaces import Action, Observation
from rcs.envs.step.chain import Chain
from rcs.errors import InvalidAction, InvalidSetup, Refused, UnknownName

NAMELESS = ""
"""Name of the chain whose keys stay at the top: that of a robot alone, or of what several robots share."""

Nested = dict[str, dict[str, Any]]
"""Actions or observations by chain."""


class Stack:
    """Chains by name. Keys are one level down under the chain's name; those of the nameless chain stay at the top."""

    def __init__(self, chains: Chain | Mapping[str, Chain], gates: Sequence[Gate] = ()) -> None:
        """Put chains side by side.

        Args:
            chains: The chain of the only robot, or those of several by name; "" is for what they share, such as
                cameras.
            gates: What every action must pass, in this order.

        Raises:
            InvalidSetup: A robot has the name of a key that the robots share.
        """
        self.chains: dict[str, Chain] = {NAMELESS: chains} if isinstance(chains, Chain) else dict(chains)
        self.gates = list(gates)
        self._names = [name for name in self.chains if name != NAMELESS]
        self._shared = self.chains.get(NAMELESS) or Chain([])
        if clash := sorted(set(self._names) & {*self._shared.action_spaces, *self._shared.observation_spaces}):
            raise InvalidSetup(f"A robot is named {clash[0]!r}, which is a key of all robots; give it another name.")
        self.action_space = _space({name: chain.action_spaces for name, chain in self.chains.items()})
        self.observation_space = _space({name: chain.observation_spaces for name, chain in self.chains.items()})
        self.executed_spaces = _space({name: chain.executed_spaces for name, chain in self.chains.items()}).spaces
        """Space of what is sent to the ports."""
        self._fallible = [(self._prefix(name), port) for name, one in self.chains.items() for port in one.fallible]
        self._aged = [
            (self._prefix(name), port)
            for name, one in self.chains.items()
            for port in one.ports
            if type(port).ages is not Port.ages
        ]

    @property
    def ports(self) -> list[Port]:
        """All ports, those of the robots first."""
        return [port for chain in self.chains.values() for port in chain.ports]

    @property
    def about(self) -> dict[str, dict[str, Any]]:
        """What recordings keep about sensors: `cameras`, how each is calibrated; `labels`, names in segmentation."""
        merged: dict[str, dict[str, Any]] = {}
        for port in self.ports:
            for key, values in port.about.items():
                merged[key] = {**merged.get(key, {}), **values}
        return merged

    @property
    def layers(self) -> list[Layer]:
        """All layers, chain by chain, from the lowest to the highest."""
        return [layer for chain in self.chains.values() for layer in chain.layers]

    @property
    def timed(self) -> list[str]:
        """What `capture_times` has an entry for, such as `frames/wrist` and `joints`."""
        return [
            self._prefix(name) + key for name, one in self.chains.items() for port in one.ports for key in port.timed
        ]

    @property
    def executed(self) -> dict[str, Any]:
        """The last action as it was sent to the ports, in the form of an action."""
        return self.squeeze({name: chain.executed for name, chain in self.chains.items()})

    @property
    def target(self) -> dict[str, Any]:
        """What the last action came to, on the highest level, in the form of an action."""
        return self.squeeze({name: chain.target for name, chain in self.chains.items()})

    def squeeze(self, nested: Nested) -> dict[str, Any]:
        """Return values by chain in the form that users see."""
        if not self._names:
            return nested[NAMELESS]
        return {**{name: nested[name] for name in self._names}, **nested.get(NAMELESS, {})}

    def map(self, action: Any) -> Nested:
        """Check the action and map it down; no device sees it, and no layer remembers it.

        Raises:
            InvalidAction: The action, or that of one robot, is not valid.
        """
        if not self._names:
            return {NAMELESS: self._shared.map(action)}
        robots = [name for name in self._names if self.chains[name].action_spaces]
        if not isinstance(action, Mapping) or action.keys() != {*robots, *self._shared.action_spaces}:
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
        """Return what the gates let through.

        Raises:
            Refused: A gate refuses, or its deadline has passed.
        """
        if not self.gates:
            return mapped
        targets: Mapping[str, Action] = mapped
        measured = {name: chain.measure_devices() for name, chain in self.chains.items()}
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
        """Return what a gate let through, once it is found to be as valid as what the gate was given.

        An arm that was found outside its range may be sent as far out as it is, or as it was sent before.

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
                valid = chain.check_executed(own, measured[name], chain.executed)
            except InvalidAction as err:
                raise Refused(f"{gate} returned what {name or 'the robot'} cannot be sent: {err}") from err
            # What a gate leaves alone stays the same array, by which layers know it.
            checked[name] = {k: own[k] if own[k] is given[name].get(k) else value for k, value in valid.items()}
        return checked

    def send(self, mapped: Nested) -> None:
        """Set the targets of all devices; nothing moves yet."""
        for name, chain in self.chains.items():
            chain.send(mapped[name])
        for gate in self.gates:
            gate.sent(mapped)

    def lead(self, targets: Nested) -> None:
        """Set the targets of all devices past the layers, which are to be reset after it; see `Chain.lead`."""
        for name, chain in self.chains.items():
            chain.lead(targets[name])
        for gate in self.gates:
            gate.sent(targets)

    def repeat(self) -> None:
        """Tell all devices once more what was sent last; the layers need not know."""
        for chain in self.chains.values():
            for port in chain.ports:
                port.command(chain.executed)

    def stay(self) -> None:
        """Hold all devices where they are measured, and take that for what the last action came to."""
        for_all([chain.stay for chain in self.chains.values()])

    def measure(self) -> Nested:
        """Return the observations of the lowest level."""
        return {name: chain.measure() for name, chain in self.chains.items()}

    def lift(self, measured: Nested) -> Observation:
        """Map the observations of the lowest level up through all layers, into the form that users see."""
        return self.squeeze({name: chain.lift(measured[name]) for name, chain in self.chains.items()})

    def reset(self, measured: Nested, where: Where) -> None:
        """Tell all layers that some copies start anew, with the lowest level's observations."""
        for name, chain in self.chains.items():
            chain.reset(measured[name], where)
        for gate in self.gates:
            gate.reset(measured, where)

    def rebase(self, robot: str | None = None) -> None:
        """Make the layers of one robot, or of all, count from the measured state.

        Raises:
            UnknownName: There is no robot of this name.
        """
        if robot is not None and robot not in self._names:
            hint = "" if self._names else "This environment has one robot; call rebase()."
            raise UnknownName("robot", robot, self._names, hint=hint)
        for name, chain in self.chains.items():
            if robot in (None, name):
                chain.rebase()
        if self.gates:
            measured = {name: chain.measure_devices() for name, chain in self.chains.items()}
            for gate in self.gates:
                gate.rebase(measured)

    def faults(self) -> dict[str, str]:
        """Return the reason of every device that is in its fault state, by the device's name or `robot/device`."""
        return {prefix + key: why for prefix, port in self._fallible for key, why in port.faults().items()}

    def ages(self) -> dict[str, Any]:
        """Return how old what is observed is in simulated time [s], by key, where it is late on purpose."""
        return {prefix + key: age for prefix, port in self._aged for key, age in port.ages().items()}

    def info(self) -> dict[str, Any]:
        """Return what layers and gates tell of the last action; of several robots' layers, `robot/key`."""
        told = {self._prefix(name) + key: v for name, one in self.chains.items() for key, v in one.info().items()}
        for gate in self.gates:
            told.update(gate.info())
        return told

    def capture_times(self) -> dict[str, float]:
        """Return when each sensor was last read [s, monotonic clock], by its key such as `frames/wrist`."""
        return {
            self._prefix(name) + key: when
            for name, chain in self.chains.items()
            for port in chain.ports
            for key, when in port.capture_times().items()
        }

    def clamped(self) -> dict[str, Mapping[str, int]]:
        """Return how many commands asked streamed arms for more than is allowed since `open`, by arm and by what."""
        arms = [port.device for port in self.ports]
        return {arm.name: arm.clamped() for arm in arms if is_streamed(arm)}

    def open(self) -> None:
        """Connect all devices; where one fails, none stays open."""
        try:
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

    def _prefix(self, name: str) -> str:
        return f"{name}/" if name else ""

    def __str__(self) -> str:
        """Return the gates, then chain after chain from top to bottom."""
        lines = [f"  gate: {gate}" for gate in self.gates]
        for name, chain in self.chains.items():
            lines += [f"  {name}:"] if name else []
            lines += [str(chain)] if chain.ports else []
        return "\n".join(lines)


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
        # What must not be caught by `except Exception` goes first.
        first = next((err for err in failures if not isinstance(err, Exception)), failures[0])
        for err in failures:
            if err is not first:
                first.add_note(f"After that, or before: {type(err).__name__}: {err}")
        raise first


def copied(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return arrays, in any nesting, that are the caller's own."""
    return {key: value.copy() if type(value) is np.ndarray else copied(value) for key, value in values.items()}
