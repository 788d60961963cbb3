"""Where the objects of a real episode go, in words, and as outlines in pictures of cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs.spaces import DISTORTION, EXTRINSICS, INTRINSICS, RGB
from rcs.rollout.placing import Poses, SeededScene
from rcs.spatial import Pose, tquat_to_matrix
from rcs.spatial.pinhole import distort

COLOUR = (255, 0, 255)
"""Colour of outlines in a picture."""
NEAREST = 0.01
"""Depth of a point before a camera below which nothing is drawn [m]."""


class Outlines(SeededScene):
    """The objects at the start of each episode of a setup, in words and in pictures."""

    def words(self, seed: int) -> str:
        """Return where the objects go, in words; empty without any."""
        return in_words(self.poses(seed))

    def seen(self, seed: int, frames: Mapping[str, Mapping[str, Any]]) -> dict[str, list[NDArray[np.float64]]]:
        """Return the outlines of the objects in pictures [px], (N, 2) each: x to the right, y down.

        Args:
            seed: Seed of the episode.
            frames: Frames of an observation, by camera, with `intrinsics`, `extrinsics` and `distortion`; a camera
                without shows nothing.
        """
        poses = self.poses(seed)
        found: dict[str, list[NDArray[np.float64]]] = {}
        for camera, frame in frames.items():
            if EXTRINSICS in frame and INTRINSICS in frame:
                corners = [_moved(corners_of(self.model, name), tquat_to_matrix(pose)) for name, pose in poses.items()]
                seen = [_projected(points, frame) for points in corners]
                found[camera] = [hull(points) for points in seen if points is not None]
        return found

    def drawn(self, seed: int, frames: Mapping[str, Mapping[str, Any]]) -> dict[str, NDArray[np.uint8]]:
        """Return the colours of frames with the outlines of the objects, by camera, (H, W, 3) uint8."""
        pictures = {name: np.array(frame[RGB]) for name, frame in frames.items() if RGB in frame}
        for name, outlines in self.seen(seed, frames).items():
            for outline in outlines:
                _draw(pictures[name], outline)
        return pictures


def in_words(poses: Poses) -> str:
    """Return where objects are, by name, in words; empty without any."""
    return "; ".join(f"the {name} at {_in_words(pose)}" for name, pose in poses.items())


def _in_words(pose: NDArray[np.float64]) -> str:
    x, y, z = pose[:3]
    roll, pitch, yaw = np.rad2deg(Pose.from_tquat(pose).xyzrpy[3:])
    tilt = f"rolled by {roll:.0f}° and pitched by {pitch:.0f}°, then " if max(abs(roll), abs(pitch)) > 1 else ""
    return (
        f"x {x:.3f} m, y {y:.3f} m, z {z:.3f} m in the frame of the base (its middle), {tilt}turned by {yaw:.0f}° "
        "counterclockwise"
    )


def corners_of(model: mujoco.MjModel, body: str) -> NDArray[np.float64]:
    """Return points in the frame of a body, (N, 3) [m], whose hull holds its geoms: boxes, discs and meshes closely."""
    found: list[NDArray[np.float64]] = []
    number = model.body(body).id
    for geom in np.flatnonzero(model.geom_bodyid == number):
        middle, half = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
        points = middle + half * np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
            around = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)
            rim = np.stack([np.cos(around), np.sin(around), np.ones(32)], axis=-1)
            points = middle + half * np.concatenate([rim, rim * (1.0, 1.0, -1.0)])
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            first = model.mesh_vertadr[mesh]
            points = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        turned = np.empty(9)
        mujoco.mju_quat2Mat(turned, model.geom_quat[geom])
        found.append(points @ turned.reshape(3, 3).T + model.geom_pos[geom])
    return np.concatenate(found)


def hull(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners of the convex hull of points (N, 2), in order.

    Source: A. M. Andrew, "Another efficient algorithm for convex hulls in two dimensions", Information Processing
    Letters 9 (1979), 216-219.
    """
    ordered = sorted(map(tuple, points.tolist()))
    sides: list[list[tuple[float, ...]]] = []
    for way in (ordered, ordered[::-1]):
        side: list[tuple[float, ...]] = []
        for point in way:
            while len(side) > 1 and _turn(side[-2], side[-1], point) <= 0:
                side.pop()
            side.append(point)
        sides.append(side[:-1])
    return np.array([*sides[0], *sides[1]])


def _turn(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _moved(points: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _projected(points: NDArray[np.float64], frame: Mapping[str, Any]) -> NDArray[np.float64] | None:
    """Return where a camera shows points, (N, 2) [px]; None if any is not before it."""
    scene_in_camera = np.asarray(np.linalg.inv(frame[EXTRINSICS]), np.float64)
    x, y, z = _moved(points, scene_in_camera).T
    if z.min() < NEAREST:
        return None
    flat = np.stack([x / z, y / z], axis=-1)
    if DISTORTION in frame:
        flat = distort(flat, frame[DISTORTION])
    matrix = np.asarray(frame[INTRINSICS], np.float64)
    return flat @ matrix[:2, :2].T + matrix[:2, 2]


def _draw(picture: NDArray[np.uint8], outline: NDArray[np.float64]) -> None:
    """Draw a closed line of two pixels into a picture."""
    height, width = picture.shape[:2]
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        steps = np.linspace(0.0, 1.0, 2 + int(np.abs(end - start).max(initial=0.0)))[:, None]
        for nudge in (0.0, 1.0):
            column, row = np.rint(start + steps * (end - start) + nudge).astype(int).T
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            picture[row[inside], column[inside]] = COLOUR
