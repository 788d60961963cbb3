"""The stack of ports and layers under an environment: one for a single environment and for a batch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.layers import Action, Layer, Where
from rcs.envs.ports import Port
from rcs.envs.spaces import ActionCheck, Observation


class Stack:
    """Ports at the bottom, layers on top of each other; actions go down, observations go up."""

    def __init__(self, ports: Sequence[Port], layers: Sequence[Layer], leading: tuple[int, ...] = ()) -> None:
        """Put a stack together.

        Args:
            ports: What talks to the devices.
            layers: From the lowest to the highest.
            leading: Leading shape of all arrays: () or (copies,).
        """
        self.ports = list(ports)
        self.layers = list(layers)
        self.leading = leading
        boxes = {key: box for port in ports for key, box in port.action_spaces.items()}
        observations = {key: space for port in ports for key, space in port.observation_spaces.items()}
        self.executed_spaces = dict(boxes)
        """Space of what is sent to the ports."""
        for layer in layers:
            boxes = layer.action_spaces(boxes)
            observations = layer.observation_spaces(observations)
        self.check = ActionCheck(boxes, leading)
        """Checks an action of the highest level; raises InvalidAction."""
        self.action_space = spaces.Dict(dict(boxes))
        self.observation_space = spaces.Dict(dict(observations))
        self.executed: dict[str, NDArray[Any]] = {}
        """The last action as it was sent to the ports."""
        self.target: dict[str, NDArray[Any]] = {}
        """What the last action came to, on the highest level: absolute targets, cut where a layer has cut them."""
        self._measured: Observation = {}
        self._fallible = [port for port in self.ports if type(port).faults is not Port.faults]

    def map(self, action: Any) -> Action:
        """Check an action and map it down; no device sees it, and no layer remembers it.

        Raises:
            InvalidAction: The action is not valid.
        """
        mapped = self.check(action)
        for layer in reversed(self.layers):
            mapped = layer.map_action(mapped)
        return mapped

    def send(self, mapped: Action) -> None:
        """Set the devices' targets, and tell the layers from the lowest up what they came to; nothing moves yet."""
        for port in self.ports:
            port.command(mapped)
        self.executed = mapped
        for layer in self.layers:
            mapped = layer.map_executed(mapped)
        self.target = mapped

    def measure(self) -> Observation:
        """Return the observation of the lowest level."""
        observation: Observation = {}
        for port in self.ports:
            observation.update(port.observe())
        self._measured = observation
        return observation

    def rebase(self) -> None:
        """Make all layers count from the measured state."""
        observation = dict(self._measured)
        for port in self.ports:
            if port.action_spaces:  # what only observes, such as a camera, need not be read for this
                observation.update(port.observe())
        for layer in self.layers:
            layer.rebase(observation)
            observation = layer.map_observation(observation)

    def faults(self) -> dict[str, str]:
        """Return the reason of every device that is in its fault state, by the device's name."""
        return {name: reason for port in self._fallible for name, reason in port.faults().items()}

    def lift(self, observation: Observation) -> Observation:
        """Map an observation of the lowest level up through all layers."""
        for layer in self.layers:
            observation = layer.map_observation(observation)
        return observation

    def reset(self, observation: Observation, where: Where) -> None:
        """Tell all layers that some copies start anew, with the lowest level's observation."""
        for layer in self.layers:
            layer.reset(observation, where)
            observation = layer.map_observation(observation)

    def info(self) -> dict[str, NDArray[Any]]:
        """Return what the layers tell of the last action."""
        told: dict[str, NDArray[Any]] = {}
        for layer in self.layers:
            told.update(layer.info())
        return told

    def capture_times(self) -> dict[str, float]:
        """Return when each slow sensor was last read [s, monotonic clock]."""
        return {key: time for port in self.ports for key, time in port.capture_times().items()}

    def hold(self) -> None:
        """Make every device stay where it is, also when one of them fails to."""
        for_all([port.hold for port in self.ports])

    def recover(self) -> None:
        """Clear the faults of all devices, also when one of them fails to; nothing moves."""
        for_all([port.recover for port in self.ports])

    def close(self) -> None:
        """Close all ports, also when one of them fails to."""
        for_all([port.close for port in self.ports])

    def __str__(self) -> str:
        """Return the stack from top to bottom, a line each."""
        lines = [f"  {layer}" for layer in reversed(self.layers)]
        for port in self.ports:
            taken, given = ", ".join(port.action_spaces) or "-", ", ".join(port.observation_spaces)
            lines.append(f"  {type(port).__name__}: {taken} -> {given}")
        return "\n".join(lines)


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
