"""Episodes as steps for training: each observation with the action that followed, joined to vectors.

An episode has one row more than steps: row 0 is the reset observation, and row i + 1 holds the action of step i and its
result. Step i of a trajectory therefore has the observation of row i, and action, reward and flags of row i + 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.errors import InvalidSetup
from rcs_data.files.feature import Feature
from rcs_data.files.flags import camera_of
from rcs_data.files.info import DatasetInfo
from rcs_data.read.episode_record import EpisodeRecord

OBSERVATION, ACTION, FRAMES = "observation", "action", "frames"

# Joined in this order by default. Poses are left out, since they follow from the joints.
_STATE_NAMES = ("joints", "gripper", "hand")
_ACTION_NAMES = ("joints", "tquat", "xyzrpy", "twist", "gripper", "hand")
# Imports make these of a vector without parts, beside which others may lie.
_WHOLE = (f"{OBSERVATION}/state", f"{ACTION}/{ACTION}")


@dataclass(frozen=True, kw_only=True)
class VectorLayout:
    """The features that make up a vector, in order."""

    features: tuple[Feature, ...]
    """The features, all of them numbers."""

    @property
    def size(self) -> int:
        """Size of the vector."""
        return sum(feature.size for feature in self.features)

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each number, such as "joints_0" or, with several robots, "left_joints_0"."""
        names: list[str] = []
        for feature in self.features:
            stem = "_".join(feature.key.split("/")[1:])
            names += [stem] if feature.size == 1 else [f"{stem}_{i}" for i in range(feature.size)]
        return tuple(names)

    @property
    def slices(self) -> dict[str, slice]:
        """Where each part is in the vector, by key."""
        slices: dict[str, slice] = {}
        start = 0
        for feature in self.features:
            slices[feature.key] = slice(start, start + feature.size)
            start += feature.size
        return slices

    def rows(self, episode: EpisodeRecord) -> NDArray[np.float64]:
        """Return the vectors of all rows of an episode, shape (length, size); NaN where a row has no value.

        Raises:
            CorruptEpisode: The episode is damaged.
        """
        return self.joined(episode.columns(feature.key for feature in self.features), episode.length)

    def joined(self, columns: Mapping[str, NDArray[Any]], length: int) -> NDArray[np.float64]:
        """Return the vectors of columns as `EpisodeRecord.columns` returns them, shape (length, size)."""
        parts = [columns[feature.key].reshape(length, -1).astype(np.float64) for feature in self.features]
        return np.concatenate(parts, axis=1) if parts else np.empty((length, 0))


def state_layout(info: DatasetInfo, keys: Sequence[str] | None = None) -> VectorLayout:
    """Return the layout of states: joints, then gripper or hand, robot by robot.

    Args:
        info: The facts that the dataset's episodes share.
        keys: Other features, such as ("observation/tquat", "observation/gripper"); None for the default.

    Raises:
        InvalidSetup: A key is unknown, an image, or may be unknown at the reset, as actions and times; or there is
            nothing to join.
    """
    layout = _layout(info, OBSERVATION, _STATE_NAMES, keys)
    if unknown := [feature.key for feature in layout.features if feature.is_unknown_at_reset or feature.is_time]:
        raise InvalidSetup(f"{unknown[0]!r} cannot be part of a state: before the first step, it may have no value.")
    return layout


def action_layout(info: DatasetInfo, keys: Sequence[str] | None = None) -> VectorLayout:
    """Return the layout of actions: the arm's part, then gripper or hand, robot by robot.

    Args:
        info: The facts that the dataset's episodes share.
        keys: Other features, such as ("executed/joints", "executed/gripper"); None for the default.

    Raises:
        InvalidSetup: A key is unknown or is an image; or there is nothing to join.
    """
    return _layout(info, ACTION, _ACTION_NAMES, keys)


def camera_features(info: DatasetInfo, kind: str = "rgb") -> dict[str, Feature]:
    """Return the image features of one kind, "rgb" or "depth", by camera."""
    images = [feature for feature in info.features if feature.is_image and feature.key.endswith(f"/{kind}")]
    return {camera: feature for feature in images if (camera := camera_of(feature.key)) is not None}


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """The steps of one episode, one fewer than rows."""

    states: NDArray[np.float64]
    """The state that was seen before each step, shape (steps, state)."""
    actions: NDArray[np.float64]
    """The action of each step, shape (steps, action)."""
    rewards: NDArray[np.float64]
    """The reward of each step, shape (steps,); 0 where the dataset has none."""
    terminated: NDArray[np.bool_]
    """Whether the step ended the episode as the task defines it, shape (steps,)."""
    truncated: NDArray[np.bool_]
    """Whether the step ended the episode for another reason, shape (steps,)."""

    def __len__(self) -> int:
        return len(self.actions)


def trajectory(episode: EpisodeRecord, state: VectorLayout, action: VectorLayout) -> Trajectory:
    """Read the steps of an episode, without its images.

    Raises:
        CorruptEpisode: The episode is damaged.
    """
    known = {feature.key for feature in episode.info.features}
    steps = max(episode.length - 1, 0)

    keys = dict.fromkeys(f.key for f in (*state.features, *action.features))
    columns = episode.columns([*keys, *(known & {"reward", "terminated", "truncated"})])

    def after(key: str, dtype: str) -> NDArray[np.generic]:
        return columns[key][1:].astype(dtype) if key in columns else np.zeros(steps, dtype)

    return Trajectory(
        states=state.joined(columns, episode.length)[:-1],
        actions=action.joined(columns, episode.length)[1:],
        rewards=after("reward", "float64").astype(np.float64),
        terminated=after("terminated", "bool").astype(np.bool_),
        truncated=after("truncated", "bool").astype(np.bool_),
    )


def _layout(info: DatasetInfo, prefix: str, names: tuple[str, ...], keys: Sequence[str] | None) -> VectorLayout:
    if keys is None:
        numbers = [f for f in info.features if f.key.startswith(f"{prefix}/") and not f.is_image]
        parts = {f: f.key.split("/") for f in numbers if f.key.split("/")[1] != FRAMES}
        # Robot by robot, and of each robot the parts in a fixed order, whatever the order in the file.
        robots = list(dict.fromkeys("/".join(words[1:-1]) for words in parts.values()))
        chosen = [
            f for robot in robots for name in names for f, words in parts.items()
            if "/".join(words[1:-1]) == robot and words[-1] == name
        ]  # fmt: skip
        if not chosen or any(f.key in _WHOLE for f in parts):
            chosen = list(parts)
    elif isinstance(keys, str):
        raise InvalidSetup(f"{keys!r} is one text; valid is a sequence of features, such as ({keys!r},).")
    else:
        chosen = [info.feature(key) for key in keys]
    images = [f.key for f in chosen if f.is_image]
    if images or not chosen:
        known = ", ".join(f.key for f in info.features if f.key.startswith(f"{prefix}/") and not f.is_image)
        what = ", ".join(images) or "Nothing"
        raise InvalidSetup(f"{what} cannot be joined to a vector of {prefix}s. Choose from: {known or 'none'}.")
    return VectorLayout(features=tuple(chosen))
