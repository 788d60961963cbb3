"""The stack of ports and layers under an environment: one for a single environment and for a batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

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

    def command(self, action: Any) -> None:
        """Check an action, map it down and set the devices' targets; nothing moves yet.

        Raises:
            InvalidAction: The action is not valid; nothing was sent to any device.
        """
        self.send(self.map_down(self.check(action)))

    def map_down(self, checked: Action) -> Action:
        """Map a checked action through all layers; no device sees it yet."""
        for layer in reversed(self.layers):
            checked = layer.map_action(checked)
        return checked

    def send(self, mapped: Action) -> None:
        """Set the devices' targets, and tell the layers from the lowest up what they came to."""
        self.executed = mapped
        for port in self.ports:
            port.command(mapped)
        for layer in self.layers:
            mapped = layer.map_executed(mapped)

    def measure(self) -> Observation:
        """Return the observation of the lowest level."""
        observation: Observation = {}
        for port in self.ports:
            observation.update(port.observe())
        return observation

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
    """Make every call, also when one fails; the first failure is raised in the end."""
    failures: list[Exception] = []
    for call in calls:
        try:
            call()
        except Exception as err:  # noqa: BLE001  every device gets its chance; the first failure is raised below
            failures.append(err)
    if failures:
        raise failures[0]
