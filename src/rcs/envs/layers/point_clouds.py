"""The points that depth cameras see."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gymnasium import spaces

from rcs.envs.layers.layer import Layer
from rcs.envs.spaces import DEPTH, DISTORTION, EXTRINSICS, FRAMES, INTRINSICS, POINTS, Observation, points_space
from rcs.spatial import deproject


class PointClouds(Layer):
    """Adds `frames`/camera/`points` to cameras with depth: the point in the base frame that each pixel shows.

    A pixel without a depth has (0, 0, 0); its colour is that of the same pixel of `rgb`. Recordings leave the points
    out: `rcs.spatial.deproject` makes the same ones of the recorded depth and matrices.
    """

    def observation_spaces(self, inner: Mapping[str, spaces.Space[Any]]) -> dict[str, spaces.Space[Any]]:
        """Add `frames`/camera/`points`."""
        frames = inner.get(FRAMES)
        if not isinstance(frames, spaces.Dict):
            return dict(inner)
        added: dict[str, spaces.Space[Any]] = {}
        for name, own in frames.spaces.items():
            assert isinstance(own, spaces.Dict)
            added[name] = own
            if {DEPTH, EXTRINSICS} <= own.spaces.keys():
                height, width = own[DEPTH].shape or (0, 0)
                added[name] = spaces.Dict({**own.spaces, POINTS: points_space(width, height)})
        return {**inner, FRAMES: spaces.Dict(added)}

    def map_observation(self, observation: Observation) -> Observation:
        """Add the points."""
        if FRAMES not in observation:
            return observation
        frames: dict[str, Any] = {}
        for name, frame in observation[FRAMES].items():
            frames[name] = frame
            if DEPTH in frame and EXTRINSICS in frame:
                points = deproject(
                    frame[DEPTH], frame[INTRINSICS], frame[EXTRINSICS], distortion=frame[DISTORTION], invalid=0.0
                )
                points.flags.writeable = False
                frames[name] = {**frame, POINTS: points}
        return {**observation, FRAMES: frames}

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return "PointClouds"
