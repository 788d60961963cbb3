"""The cameras of a scene, drawn together: one update of the picture's scene per step, then every camera."""

from __future__ import annotations

import time
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs._core import Camera, CameraMode, Frame, Renderer, RenderPool
from rcs.errors import InvalidSetup
from rcs.sim.noise import CameraNoise
from rcs.sim.scene import CameraPlacement
from rcs.sim.world import World
from rcs.spatial import tquat_to_matrix

Quality = Literal["fast", "full"]
"""`fast`: no shadows, reflections or antialiasing. `full`: all of these."""

MAX_SIZE = 4096
"""Largest edge of a frame [px]."""


class SimCameras:
    """All cameras of a world's scene. The renderer is made at the first `read`, and draws on its own GL context."""

    def __init__(
        self,
        world: World,
        cameras: list[CameraPlacement],
        *,
        size: tuple[int, int] = (224, 224),
        has_depth: bool = False,
        quality: Quality = "fast",
        frame_body: int = 0,
        has_noise: bool = False,
    ) -> None:
        """Look the cameras up.

        Args:
            world: The world that they see.
            cameras: Cameras of its scene.
            size: Width and height of every frame [px].
            has_depth: Draw depth too.
            quality: How much a frame may cost.
            has_noise: Add the noise of real cameras.
            frame_body: Body in whose frame extrinsics are given: the robot's base, or 0 for the scene.

        Raises:
            InvalidSetup: A size out of range, or depth from a camera that has none.
        """
        if not all(1 <= edge <= MAX_SIZE for edge in size):
            raise InvalidSetup(f"The size of a frame is {size}; valid is 1 to {MAX_SIZE} px for width and height.")
        for camera in cameras:
            if has_depth and not camera.camera.has_depth:
                raise InvalidSetup(f"Camera {camera.name!r} ({camera.camera.label}) has no depth.")
        self._world = world
        self.placements = list(cameras)
        self.names = [camera.name for camera in cameras]
        self.size = size
        self.has_depth = has_depth
        self._quality: Quality = quality
        self._ids = [world.model.camera(camera.camera_name).id for camera in cameras]
        # A camera's body has the optical frame: x right, y down, z forward.
        bodies = [f"{camera.name}/{camera.camera.base_body}" for camera in cameras]
        self._poses = [world.core.read_body_pose(world.model.body(body).id, frame_body) for body in bodies]
        world.refresh()
        self._noise = [CameraNoise(camera.camera, size, i) for i, camera in enumerate(cameras)] if has_noise else []
        self._renderer: Renderer | RenderPool | None = None
        self.capture_times: dict[str, float] = {}
        """When each camera's last frame was drawn [s], on the monotonic clock."""

    def read(self) -> dict[str, dict[str, NDArray[Any]]]:
        """Draw every camera.

        Returns:
            Per camera `rgb` (*leading, H, W, 3) uint8; with depth, `depth` (*leading, H, W) uint16 [mm], 0 = no
            reading; `intrinsics` (*leading, 3, 3) [px]; `extrinsics` (*leading, 4, 4), its pose in OpenCV axes.
        """
        width, height = self.size
        leading = self._world.leading
        rgb = [np.empty((*leading, height, width, 3), np.uint8) for _ in self._ids]
        depth = [np.empty((*leading, height, width), np.uint16) for _ in self._ids] if self.has_depth else None
        renderer = self._renderer or self._make_renderer()
        if isinstance(renderer, RenderPool):
            renderer.render_states(self._world.core.states, self._ids, rgb, depth, self._world.core)
            self.capture_times = dict.fromkeys(self.names, time.perf_counter())
        else:
            data = self._world.data
            assert data is not None
            mujoco.mj_camlight(self._world.model, data)
            renderer.update(data._address)  # pyright: ignore[reportPrivateUsage]
            for i, camera in enumerate(self._ids):
                renderer.render(camera, rgb[i], None if depth is None else depth[i])
                self.capture_times[self.names[i]] = time.perf_counter()
        frames: dict[str, dict[str, NDArray[Any]]] = {}
        for i, name in enumerate(self.names):
            frames[name] = {"rgb": rgb[i], **self._calibration(i)}
            if depth is not None:
                frames[name]["depth"] = depth[i]
            if self._noise:
                frames[name] = self._noise[i].add(frames[name], self._world.qpos)
        return frames

    def _calibration(self, i: int) -> dict[str, NDArray[np.float64]]:
        """Return the matrices of a camera as it is now: it may move, and its field of view may vary."""
        width, height = self.size
        focal = 0.5 * height / np.tan(0.5 * np.deg2rad(self._world.field("cam_fovy")[..., self._ids[i]]))
        intrinsics = np.zeros((*self._world.leading, 3, 3))
        intrinsics[..., 0, 0] = intrinsics[..., 1, 1] = focal
        # The centre of the top left pixel is (0, 0), as in OpenCV.
        intrinsics[..., 0, 2], intrinsics[..., 1, 2], intrinsics[..., 2, 2] = (width - 1) / 2, (height - 1) / 2, 1.0
        return {
            "intrinsics": intrinsics,
            "extrinsics": tquat_to_matrix(self._world.poses[..., self._poses[i], :]),
        }

    def _make_renderer(self) -> Renderer | RenderPool:
        width, height = self.size
        address = self._world.model._address  # pyright: ignore[reportPrivateUsage]
        if self._world.leading:
            threads = self._world.core.threads
            self._renderer = RenderPool(
                address, threads=threads, quality=self._quality, max_width=width, max_height=height
            )
        else:
            self._renderer = Renderer(address, quality=self._quality, max_width=width, max_height=height)
        return self._renderer

    def close(self) -> None:
        """Free the renderer. Closing twice is harmless; reading again makes a new one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


class SimCamera(Camera):
    """One camera of a world of one copy as a device."""

    def __init__(self, cameras: SimCameras, name: str, world: World) -> None:
        """Use one of a scene's cameras.

        Raises:
            InvalidSetup: The world has many copies, or no camera of that name.
        """
        if world.leading or name not in cameras.names:
            raise InvalidSetup(
                f"SimCamera needs a world of one copy and one of the cameras {cameras.names}, not {name!r}."
            )
        width, height = cameras.size
        super().__init__(name, CameraMode(width, height, world.frequency, cameras.has_depth))
        self._cameras = cameras
        self._world = world

    def _read(self) -> Frame:
        frame = self._cameras.read()[self.name]
        number = int(self._world.core.steps[0])
        return Frame(frame["rgb"], frame.get("depth"), float(self._world.time), number)

    def _close(self) -> None:
        self._cameras.close()
