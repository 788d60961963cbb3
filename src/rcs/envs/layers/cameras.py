"""Poses of cameras on grippers, and the points that depth cameras see."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.layers.layer import Layer
from rcs.envs.spaces import DEPTH, DISTORTION, EXTRINSICS, FRAMES, INTRINSICS, POINTS, TQUAT, Observation, frame_space
from rcs.spatial import Pose, deproject, tquat_to_matrix


class WristCamera(Layer):
    """Adds the pose of a camera that moves with the gripper, computed from the measured TCP pose."""

    def __init__(self, camera: str, camera_in_tcp: Pose) -> None:
        """Set the mount.

        Args:
            camera: Name of the camera.
            camera_in_tcp: Pose of its optical frame (x right, y down, z forward) in the TCP frame.
        """
        self._camera = camera
        self._camera_in_tcp: NDArray[np.float64] = camera_in_tcp.matrix

    def observation_spaces(self, inner: Mapping[str, spaces.Space[Any]]) -> dict[str, spaces.Space[Any]]:
        """Add `frames`/camera/`extrinsics`."""
        frames = inner[FRAMES]
        assert isinstance(frames, spaces.Dict)
        own = frames[self._camera]
        assert isinstance(own, spaces.Dict)
        with_pose = spaces.Dict({**own.spaces, **frame_space([EXTRINSICS], (0, 0)).spaces})
        return {**inner, FRAMES: spaces.Dict({**frames.spaces, self._camera: with_pose})}

    def map_observation(self, observation: Observation) -> Observation:
        """Add the camera's pose in the base frame."""
        frames = observation[FRAMES]
        extrinsics = tquat_to_matrix(observation[TQUAT]) @ self._camera_in_tcp
        return {**observation, FRAMES: {**frames, self._camera: {**frames[self._camera], EXTRINSICS: extrinsics}}}

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return f"WristCamera({self._camera})"


class PointClouds(Layer):
    """Adds `frames`/camera/`points` to cameras with depth: the point in the base frame that each pixel shows.

    A pixel without a depth has (0, 0, 0); its colour is that of the same pixel of `rgb`. Recordings leave the points
    out, because `rcs.spatial.deproject` computes the same ones from the recorded depth and matrices.
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
                added[name] = spaces.Dict({**own.spaces, **frame_space([POINTS], (width, height)).spaces})
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
