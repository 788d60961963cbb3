"""Several stacks side by side: one per robot, and one for what they share, behind the interface of a single stack."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gymnasium import spaces

from rcs.envs.layers import Where
from rcs.envs.ports import Port
from rcs.envs.spaces import Observation
from rcs.envs.stack import Stack, for_all
from rcs.errors import InvalidAction, UnknownName


class StackGroup:
    """Stacks of several robots. Keys are one level down, under the robots' names; what is shared stays at the top."""

    def __init__(self, robots: Mapping[str, Stack], shared: Stack) -> None:
        """Put stacks side by side.

        Args:
            robots: The stack of every robot, by its name.
            shared: Ports that belong to no robot, such as cameras; it takes no actions.
        """
        self.robots = dict(robots)
        self.shared = shared
        self.leading = shared.leading
        self.action_space = spaces.Dict({name: stack.action_space for name, stack in robots.items()})
        self.observation_space = spaces.Dict(
            {
                **{name: stack.observation_space for name, stack in robots.items()},
                **shared.observation_space.spaces,
            }
        )
        self.executed_spaces: dict[str, spaces.Space[Any]] = {
            name: spaces.Dict(dict[str, spaces.Space[Any]](stack.executed_spaces)) for name, stack in robots.items()
        }

    @property
    def ports(self) -> list[Port]:
        """All ports, those of the robots first."""
        return [port for stack in (*self.robots.values(), self.shared) for port in stack.ports]

    @property
    def executed(self) -> dict[str, Any]:
        """The last action as it was sent to the ports, under the robots' names."""
        return {name: stack.executed for name, stack in self.robots.items()}

    @property
    def target(self) -> dict[str, Any]:
        """What the last action came to, on the highest level, under the robots' names."""
        return {name: stack.target for name, stack in self.robots.items()}

    def map(self, action: Any) -> dict[str, Any]:
        """Check the actions of all robots and map them down; no device sees them, and no layer remembers them.

        Raises:
            InvalidAction: The action of a robot is not valid.
        """
        if not isinstance(action, Mapping) or action.keys() != self.robots.keys():
            given = sorted(map(str, action)) if isinstance(action, Mapping) else type(action).__name__
            raise InvalidAction(f"Expected one action per robot, {sorted(self.robots)}; got {given}.")
        mapped: dict[str, Any] = {}
        for name, stack in self.robots.items():
            try:
                mapped[name] = stack.map(action[name])
            except InvalidAction as err:
                raise InvalidAction(f"Robot {name!r}: {err}") from err
        return mapped

    def send(self, mapped: Mapping[str, Any]) -> None:
        """Set the targets of all devices; nothing moves yet."""
        for name, stack in self.robots.items():
            stack.send(mapped[name])

    def measure(self) -> Observation:
        """Return the observation of the lowest level."""
        return {**{name: stack.measure() for name, stack in self.robots.items()}, **self.shared.measure()}

    def rebase(self, robot: str | None = None) -> None:
        """Make the layers of one robot, or of all, count from the measured state.

        Raises:
            UnknownName: There is no robot of this name.
        """
        if robot is not None and robot not in self.robots:
            raise UnknownName("robot", robot, self.robots)
        for name, stack in self.robots.items():
            if robot in (None, name):
                stack.rebase()

    def faults(self) -> dict[str, str]:
        """Return the reason of every device that is in its fault state, by `robot/device`."""
        own = {f"{name}/{key}": why for name, stack in self.robots.items() for key, why in stack.faults().items()}
        return own | self.shared.faults()

    def lift(self, observation: Observation) -> Observation:
        """Map an observation of the lowest level up through all layers."""
        lifted = {name: stack.lift(observation[name]) for name, stack in self.robots.items()}
        return {**observation, **lifted}

    def reset(self, observation: Observation, where: Where) -> None:
        """Tell all layers that some copies start anew, with the lowest level's observation."""
        for name, stack in self.robots.items():
            stack.reset(observation[name], where)

    def info(self) -> dict[str, Any]:
        """Return what the layers tell of the last action, `robot/key`."""
        return {f"{name}/{key}": value for name, stack in self.robots.items() for key, value in stack.info().items()}

    def capture_times(self) -> dict[str, float]:
        """Return when each slow sensor was last read [s, monotonic clock]."""
        return self.shared.capture_times()

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
        """Return the stacks, one after the other."""
        parts = [f"  {name}:\n{stack}" for name, stack in self.robots.items()]
        return "\n".join([*parts, *([str(self.shared)] if self.shared.ports else [])])
