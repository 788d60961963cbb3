"""Dictionaries of an environment as vectors, and back: what learners read and write."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from rcs.envs.spaces import PIXELS
from rcs.errors import InvalidAction, InvalidSetup
from rcs.rl.entries import layout_of
from rcs.rl.layout import FlatLayout, Image
from rcs.rl.poses import PosePlan
from rcs.rl.scales import Workplace, workplace_of
from rcs.rl.selection import Selection
from rcs.rl.tables import Table, at, put

STATE = "state"
"""Key of the vector in a flat observation that has images too."""


class Flat:
    """Maps between dictionaries and vectors, for one environment, many copies, or a policy without any.

    Arrays are indexed from the right: an observation of one copy, (n,) per key, becomes a vector, one of many copies,
    (copies, n), a matrix. The maps remember nothing, and the same numbers give the same bits in a batch of any size.

    Actions: -1 and 1 are the bounds of every number; vectors are clipped to them. Observations: each number is
    `(value - offset) / scale`, about -1 to 1 in what usually occurs, and never clipped, so that the way back is exact;
    `observation_space` has the true bounds. `print(flat.layout)` says what each number is, and why.

    Rotations are told by two columns of their matrix, which has no jumps; back comes the quaternion with w >= 0.
    """

    def __init__(self, of: Any, selection: Selection | None = None) -> None:
        """Choose what the vectors have.

        Args:
            of: An `Env` or `VecEnv`, or the layout of another Flat, which is all that the maps need.
            selection: What goes into the vectors of an environment; None for all that there is.

        Raises:
            InvalidSetup: A space is not one of numbers, a key or a camera is unknown, or nothing is left.
        """
        if not isinstance(of, FlatLayout):
            workplace = workplace_of(of)
            action = getattr(of, "single_action_space", of.action_space)
            observation = getattr(of, "single_observation_space", of.observation_space)
            of = layout_of(action, observation, workplace, selection or Selection())
        elif selection is not None:
            raise InvalidSetup("A layout was given and also a selection; the layout says what the vectors have.")
        self.layout: FlatLayout = of
        """What the numbers are."""
        layout = self.layout
        self._action = Table(layout.action)
        self._state = Table(layout.state)
        self._poses = PosePlan(layout.state, {name: np.array(base) for name, base in layout.bases.items()})
        self.action_space = spaces.Box(-1.0, 1.0, (layout.action_size,), np.float32)
        """The space of vectors of one action."""
        self.state_space = spaces.Box(self._state.low, self._state.high, dtype=np.float32)
        """The space of vectors of one observation."""
        self.observation_space: spaces.Box | spaces.Dict = self.state_space
        """The space of one flat observation: the vector, or, with cameras, a dictionary with the vector as `state` and
        a frame (channels, height, width) per camera."""
        if layout.images:
            frames: dict[str, spaces.Space[Any]] = {
                image.name: spaces.Box(0, 255, image.shape, np.uint8) for image in layout.images
            }
            self.observation_space = spaces.Dict(({STATE: self.state_space} if layout.state else {}) | frames)

    @classmethod
    def from_spaces(cls, action_space: spaces.Space[Any], observation_space: spaces.Space[Any]) -> Flat:
        """Make the maps from two spaces of one copy; scales are then general ones, for the robots are not known."""
        return cls(layout_of(action_space, observation_space, Workplace(), Selection()))

    # --- Actions ------------------------------------------------------------------------------------------------------

    def action(self, vector: ArrayLike) -> dict[str, Any]:
        """Return the action of a vector.

        Args:
            vector: Shape (..., n); what is beyond -1 and 1 counts as -1 and 1.

        Raises:
            InvalidAction: A number is not finite, or the shape is wrong.
        """
        given = np.asarray(vector, np.float64)
        size = self.layout.action_size
        if given.ndim == 0 or given.shape[-1] != size:
            raise InvalidAction(f"The action has shape {given.shape}; valid is (..., {size}).")
        if not np.isfinite(given).all():
            index = tuple(map(int, np.argwhere(~np.isfinite(given))[0]))
            raise InvalidAction(f"The action's number {list(index)} is {given[index]}; valid is -1 to 1.")
        return self._action.nested(np.minimum(np.maximum(given, -1.0), 1.0))

    def action_vector(self, action: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the vector of an action, (..., n): the inverse of `action`.

        Raises:
            InvalidSetup: A key is missing, or an array has a wrong shape.
        """
        return self._action.scale_in_place(self._action.gathered(action)).astype(np.float32)

    # --- Observations -------------------------------------------------------------------------------------------------

    def observation(self, observation: Mapping[str, Any]) -> Any:
        """Return the flat observation: a vector (..., n), or, with cameras, a dictionary with it and the frames.

        All arrays are new, but for frames that have channels first already.

        Raises:
            InvalidSetup: A key is missing, or an array has a wrong shape.
        """
        if not self.layout.images:
            return self.state(observation)
        flat = {STATE: self.state(observation)} if self.layout.state else {}
        return flat | {image.name: _picture(observation, image) for image in self.layout.images}

    def state(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the vector of an observation, (..., n), without frames.

        Raises:
            InvalidSetup: A key is missing, or an array has a wrong shape.
        """
        vector = self._state.gathered(observation)
        if paths := self._poses.paths:
            poses = np.empty((*vector.shape[:-1], len(paths), 7))
            for i, path in enumerate(paths):
                poses[..., i, :] = at(observation, path)
            self._poses.write(poses, vector)
        self._state.scale_in_place(vector)
        self._poses.bound(vector)
        return vector.astype(np.float32)

    def observation_dict(self, flat: Any) -> dict[str, Any]:
        """Return the dictionary of a flat observation: the inverse of `observation`, with the keys that it has.

        Frames are views with channels last; depth has the steps of its levels.

        Raises:
            InvalidSetup: The vector has a wrong shape.
        """
        vector = flat if not self.layout.images else flat.get(STATE, np.zeros(0))
        given = np.asarray(vector, np.float64)
        size = self.layout.state_size
        if given.ndim == 0 or given.shape[-1] != size:
            raise InvalidSetup(f"The vector has shape {given.shape}; valid is (..., {size}).")
        nested = self._state.nested(given)
        for image in self.layout.images:
            put(nested, image.path, _frame(np.asarray(flat[image.name]), image))
        return nested

    def __repr__(self) -> str:
        """Return the sizes."""
        images = "".join(f", {image.name} {'x'.join(map(str, image.shape))}" for image in self.layout.images)
        return f"Flat({self.layout.state_size} numbers{images} -> {self.layout.action_size} numbers)"


def _picture(observation: Mapping[str, Any], image: Image) -> NDArray[np.uint8]:
    frame = at(observation, image.path)
    if image.is_depth:
        return np.minimum(frame // np.uint16(image.level_mm), 255).astype(np.uint8)[..., None, :, :]
    if frame.shape[-3:] == image.shape:
        return frame
    return np.ascontiguousarray(np.moveaxis(frame, -1, -3))


def _frame(picture: NDArray[np.uint8], image: Image) -> NDArray[Any]:
    if image.is_depth:
        return picture[..., 0, :, :].astype(np.uint16) * np.uint16(image.level_mm)
    return picture if image.path[-1] == PIXELS else np.moveaxis(picture, -3, -1)
