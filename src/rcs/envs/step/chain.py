"""The ports of one robot and the layers on top of them: actions go down, observations go up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.layers.layer import CopyIndex, Layer
from rcs.envs.ports.port import Port
from rcs.envs.spaces import ARM_KEYS, JOINTS, TWIST, Action, ActionCheck, Observation
from rcs.errors import InvalidSetup, RcsError


class Chain:
    """The ports of one robot and the layers above them, and how actions and observations pass the layers.

    It moves no device; `Stack` does. The methods serve a single environment and a batch.
    """

    def __init__(self, ports: Sequence[Port], layers: Sequence[Layer] = (), leading: tuple[int, ...] = ()) -> None:
        """Put a chain together.

        Args:
            ports: Access to the devices. Ports may give parts of the same nested key, such as `frames`.
            layers: From the lowest to the highest.
            leading: Leading shape of all arrays: () or (copies,).

        Raises:
            InvalidSetup: Two ports take or give the same key, or a layer needs a key that is not below it or returns
                no spaces.
        """
        self.ports = list(ports)
        self.layers = list(layers)
        boxes: dict[str, spaces.Box] = {}
        observations: dict[str, spaces.Space[Any]] = {}
        for port in ports:
            if taken := sorted(boxes.keys() & port.action_spaces.keys()):
                raise InvalidSetup(f"Two ports take the action {taken[0]!r}; {type(port).__name__} is the second.")
            boxes.update(port.action_spaces)
            observations = _merged_spaces(observations, port.observation_spaces, type(port).__name__)
        self._is_disjoint = sum(len(port.observation_spaces) for port in ports) == len(observations)
        self.executed_spaces = dict(boxes)
        """Spaces of the targets that the ports take."""
        self._measured_spaces = dict(observations)
        self._forms: dict[int, tuple[dict[str, spaces.Box], dict[str, spaces.Space[Any]]]] = {}
        """Actions that the level below a layer takes and observations that the layer gives, by the layer's `id`."""
        for layer in layers:
            below = boxes
            try:
                boxes, observations = layer.action_spaces(boxes), layer.observation_spaces(observations)
            except KeyError as err:
                _explain(layer, err, {**boxes, **observations})
                raise
            _require_spaces(f"{layer}.action_spaces", boxes, spaces.Box)
            _require_spaces(f"{layer}.observation_spaces", observations, spaces.Space)
            self._forms[id(layer)] = below, observations
        self._leading = leading
        self._is_mapped = self._is_lifted = False
        """Whether the values that layers return have been compared with their spaces; once is enough."""
        self.check = ActionCheck(boxes, leading)
        """Checks an action of the highest level; raises InvalidAction."""
        self.joint_space = next((port.joint_space for port in ports if port.joint_space is not None), boxes.get(JOINTS))
        """Space of the arm's joint targets, which it also takes where its actions are poses or twists."""
        self._check_executed = ActionCheck(self.executed_spaces, leading)
        self._check_joints = ActionCheck(_with_joints(self.executed_spaces, self.joint_space), leading)
        self.action_spaces = dict(boxes)
        self.observation_spaces = dict(observations)

    def map(self, action: Any) -> Action:
        """Check an action and map it down; no layer remembers it.

        Raises:
            InvalidAction: The action is not valid.
            InvalidSetup: A layer needs a key that is missing, or returns other keys or shapes than its spaces have.
        """
        mapped = self.check(action)
        for layer in reversed(self.layers):
            try:
                mapped = layer.map_action(mapped)
            except KeyError as err:
                _explain(layer, err, mapped)
                raise
            if not self._is_mapped and id(layer) in self._forms:
                _require_form(f"The layer {layer} gives the action", mapped, self._forms[id(layer)][0], self._leading)
        self._is_mapped = True
        return mapped

    def map_executed(self, executed: Action) -> Action:
        """Pass the executed targets up through all layers, which remember them, and return the result."""
        for layer in self.layers:
            try:
                executed = layer.map_executed(executed)
            except KeyError as err:
                _explain(layer, err, executed)
                raise
        return executed

    def check_executed(self, action: Any, *places: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Check targets of the lowest level as `ActionCheck` does; an arm may always have `joints`.

        Raises:
            InvalidAction: The targets are not valid.
        """
        has_joints = isinstance(action, Mapping) and JOINTS in action
        return (self._check_joints if has_joints else self._check_executed)(action, *places)

    def at_rest(self, measured: Observation) -> Action:
        """Return the targets of the lowest level with which all devices stay as they are.

        Arms stay where they are measured, and grippers keep their last target: what they hold would fall otherwise.
        """
        targets: Action = {
            key: np.zeros(box.shape, box.dtype) if key == TWIST else np.asarray(measured[key], box.dtype)
            for key, box in self.executed_spaces.items()
        }
        for port in self.ports:
            targets.update(port.kept())
        return targets

    def measure(self) -> Observation:
        """Return the observation of the lowest level."""
        observation: Observation = {}
        for port in self.ports:
            if self._is_disjoint:
                observation.update(port.observe())
            else:
                observation = merged(observation, port.observe())
        return observation

    def lift(self, observation: Observation) -> Observation:
        """Map an observation of the lowest level up through all layers."""
        for layer in self.layers:
            observation = layer.map_observation(observation)
        return observation

    def rebase(self, observation: Observation) -> None:
        """Make all layers continue from an observation of the lowest level."""
        for layer in self.layers:
            layer.rebase(observation)
            observation = layer.map_observation(observation)

    def reset(self, observation: Observation, where: CopyIndex) -> None:
        """Start episodes of some copies in all layers, with an observation of the lowest level.

        Raises:
            InvalidSetup: A layer needs a key that is missing, or returns other keys or shapes than its spaces have.
        """
        if not self._is_lifted:
            ports = ", ".join(type(port).__name__ for port in self.ports)
            _require_form(f"{ports} give the observation", observation, self._measured_spaces, self._leading)
        for layer in self.layers:
            try:
                layer.reset(observation, where)
                observation = layer.map_observation(observation)
            except KeyError as err:
                _explain(layer, err, observation)
                raise
            if not self._is_lifted and id(layer) in self._forms:
                given = self._forms[id(layer)][1]
                _require_form(f"The layer {layer} gives the observation", observation, given, self._leading)
        self._is_lifted = True

    def __str__(self) -> str:
        """Return the chain from top to bottom, a line each with its purpose."""
        lines = [(str(layer), _purpose(layer)) for layer in reversed(self.layers)]
        for port in self.ports:
            taken, given = ", ".join(port.action_spaces) or "-", ", ".join(port.observation_spaces)
            lines.append((f"{type(port).__name__}: {taken} -> {given}", _purpose(port)))
        width = max((len(name) for name, _ in lines), default=0)
        return "\n".join(f"  {name:{width}}  # {purpose}" for name, purpose in lines)


def _with_joints(boxes: Mapping[str, spaces.Box], joints: spaces.Box | None) -> dict[str, spaces.Box]:
    """Return spaces in which the arm takes joints, whatever else it takes otherwise."""
    if joints is None:
        return dict(boxes)
    return {JOINTS: joints, **{key: box for key, box in boxes.items() if key not in ARM_KEYS}}


def _require_spaces(who: str, found: Any, kind: type[spaces.Space[Any]]) -> None:
    """Check the spaces that a layer returns.

    Raises:
        InvalidSetup: They are no dictionary of spaces.
    """
    if not isinstance(found, Mapping) or not all(isinstance(space, kind) for space in found.values()):
        raise InvalidSetup(f"{who} returned {found!r}; valid is a dictionary with a {kind.__name__} for each key.")


def _explain(layer: Layer, error: KeyError, below: Mapping[str, Any]) -> None:
    """Raise an error that names the layer in place of Python's own KeyError.

    Raises:
        InvalidSetup: The error is not one of `rcs.errors`, which say enough.
    """
    if not isinstance(error, RcsError):
        keys = ", ".join(map(repr, below))
        raise InvalidSetup(
            f"The layer {layer} needs the key {error}, which is missing; the keys are {keys}."
        ) from error


def _require_form(
    who: str, given: Any, declared: Mapping[str, spaces.Space[Any]], leading: tuple[int, ...], path: str = ""
) -> None:
    """Check keys, shapes and dtypes of an action or an observation.

    Raises:
        InvalidSetup: They are not those of the spaces.
    """
    if not isinstance(given, Mapping) or given.keys() != declared.keys():
        found = ", ".join(f"{path}{key}" for key in given) if isinstance(given, Mapping) else repr(given)
        valid = ", ".join(f"{path}{key}" for key in declared)
        raise InvalidSetup(f"{who} with the keys {found}; its spaces have {valid}.")
    for key, space in declared.items():
        value = given[key]
        if isinstance(space, spaces.Dict):
            _require_form(who, value, space.spaces, leading, f"{path}{key}/")
        elif isinstance(space, spaces.Box):
            shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
            if shape != leading + space.shape or dtype != space.dtype:
                found = f"{shape} {dtype}" if shape is not None else repr(value)
                raise InvalidSetup(
                    f"{who} {path}{key!r} as {found}; its space says {leading + space.shape} {space.dtype}."
                )


def _purpose(part: object) -> str:
    return (type(part).__doc__ or "").strip().partition("\n")[0].rstrip(".")


def _merged_spaces(
    one: Mapping[str, spaces.Space[Any]], other: Mapping[str, spaces.Space[Any]], port: str, path: str = ""
) -> dict[str, spaces.Space[Any]]:
    merged = dict(one)
    for key, space in other.items():
        mine = merged.get(key)
        if isinstance(mine, spaces.Dict) and isinstance(space, spaces.Dict):
            space = spaces.Dict(_merged_spaces(mine.spaces, space.spaces, port, f"{path}{key}/"))
        elif mine is not None:
            raise InvalidSetup(f"Two ports give the observation '{path}{key}'; {port} is the second. Rename a sensor.")
        merged[key] = space
    return merged


def merged(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """Return all entries; of dictionaries under the same key, those of both."""
    return {
        **one,
        **{
            key: {**one[key], **value} if isinstance(value, dict) and isinstance(one.get(key), dict) else value
            for key, value in other.items()
        },
    }
