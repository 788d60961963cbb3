"""The pose of a camera on a gripper, from the pose of the arm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.layers.layer import Layer
from rcs.envs.spaces import EXTRINSICS, FRAMES, TQUAT, Observation, extrinsics_space
from rcs.spatial import Pose, tquat_to_matrix


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
        with_pose = spaces.Dict({**own.spaces, EXTRINSICS: extrinsics_space()})
        return {**inner, FRAMES: spaces.Dict({**frames.spaces, self._camera: with_pose})}

    def map_observation(self, observation: Observation) -> Observation:
        """Add the camera's pose in the base frame."""
        frames = observation[FRAMES]
        extrinsics = tquat_to_matrix(observation[TQUAT]) @ self._camera_in_tcp
        return {**observation, FRAMES: {**frames, self._camera: {**frames[self._camera], EXTRINSICS: extrinsics}}}

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return f"WristCamera({self._camera})"
