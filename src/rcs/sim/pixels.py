"""Frames for learners: channels first, in stacks, drawn by the threads that step the copies."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from rcs_data.options import Meta, Record, Whole

from rcs._core import PixelCameras
from rcs.sim.camera_feed import FrameClock
from rcs.sim.optics import Optics
from rcs.sim.scene import CameraPlacement
from rcs.sim.world import World

PIXELS = "pixels"
"""Key of a camera's frames in an observation."""


class Pixels(Record):
    """How cameras are observed for learning: `frames`/camera/`pixels`, uint8, (channels, height, width), and no more.

    In quality `fast`, scenes without textures, soft bodies and height fields are drawn without OpenGL, in a fifth to a
    half of the time. The pictures look like those of OpenGL; rounding differs.
    """

    grayscale: bool = False
    """One channel of luma (ITU-R BT.601) instead of red, green and blue."""
    stack: Annotated[int, Meta(ge=1, le=64)] = 1
    """Frames of an observation, one after the other along the channels, the newest last. An episode starts with its
    first frame in every place."""
    valid_steps: Whole | None = None
    """Number of steps after its own for which an observation's pixels stay as they are; then their memory is used
    again. None: forever, in new arrays. Learners that copy the pixels that they keep can do with 1, which saves time
    and memory."""

    @property
    def channels(self) -> int:
        """Channels of all frames of a stack together."""
        return self.stack * (1 if self.grayscale else 3)


class PixelFeed:
    """The newest stack of every camera and copy, for one copy and for many. Takes the place of a `CameraFeed`.

    Cameras with a frame in each step are drawn by the thread that has stepped a copy, right after its step; `read`
    draws only what has changed otherwise: copies that have started, or whose state was set.
    """

    memory = ("stacks",)

    def __init__(
        self,
        world: World,
        cameras: Sequence[CameraPlacement],
        clock: FrameClock,
        pixels: Pixels,
        *,
        size: tuple[int, int],
        quality: str = "fast",
    ) -> None:
        """Prepare the cameras; nothing is drawn before the first `read`.

        Args:
            world: The world to draw.
            cameras: Cameras of its scene.
            clock: Has the rates of these cameras, and no other user.
            pixels: Format of the frames.
            size: Width and height of a frame [px].
            quality: Rendering quality, `fast` or `full`.

        Raises:
            InvalidSetup: A camera's distortion cannot be drawn.
        """
        self.names = [camera.name for camera in cameras]
        self.pixels = pixels
        self.size = size
        self.capture_times: dict[str, float] = {}
        """When each camera's last frames were read [s], on the monotonic clock."""
        self._world = world
        self._clock = clock
        self._quality = quality
        self._optics = {camera.name: Optics(camera, size, world.model) for camera in cameras}
        regular = [name for name in self.names if clock.has_frame_each_step(name)]
        self._groups = [_Group(regular, is_regular=True)] if regular else []
        self._groups += [_Group([name], is_regular=False) for name in self.names if name not in regular]
        self._states: NDArray[np.float64] | None = None
        """The states that were last seen, (copies, state_size)."""

    def read(self) -> dict[str, dict[str, NDArray[np.uint8]]]:
        """Return the newest stack of each camera as `pixels`, (*leading, channels, height, width), read-only."""
        is_new = self._clock.take()
        is_start = self._clock.steps == 0
        states = np.atleast_2d(self._world.states())
        is_known = np.zeros(len(states), np.bool_) if self._states is None else (states == self._states).all(axis=-1)
        for group in self._groups:
            if group.core is None:
                self._open(group)
            assert group.core is not None
            if group.is_regular:
                uses = np.where(is_known, PixelCameras.KEEP, PixelCameras.REPLACE)
                uses = np.where(group.core.drawn, PixelCameras.LEAVE, uses)
            else:
                uses = np.where(is_new[group.names[0]], PixelCameras.ADVANCE, PixelCameras.KEEP)
            uses = np.where(is_start, PixelCameras.START, uses).astype(np.uint8)
            if (uses != PixelCameras.LEAVE).any():
                group.core.show(self._world.core, uses)
            group.turn(self._room(group))
        self._states = np.array(states)
        self.capture_times.update(dict.fromkeys(self.names, time.perf_counter()))
        return {
            name: {PIXELS: self._seen(group.last[i])} for group in self._groups for i, name in enumerate(group.names)
        }

    @property
    def stacks(self) -> dict[str, NDArray[np.uint8]]:
        """The last stack of each camera, (*leading, channels, height, width)."""
        read = [group for group in self._groups if group.last]
        return {name: self._seen(own) for group in read for name, own in zip(group.names, group.last, strict=True)}

    @stacks.setter
    def stacks(self, stacks: Mapping[str, NDArray[np.uint8]]) -> None:
        for group in self._groups:
            if group.core is None:
                self._open(group)
            group.go_on([np.array(stacks[name]).reshape(self._shape) for name in group.names])

    @property
    def _shape(self) -> tuple[int, int, int, int]:
        return (self._world.copies, self.pixels.channels, self.size[1], self.size[0])

    def _seen(self, stack: NDArray[np.uint8]) -> NDArray[np.uint8]:
        seen = stack.reshape(*self._world.leading, *self._shape[1:])
        seen.flags.writeable = False
        return seen

    def _open(self, group: _Group) -> None:
        world, (width, height) = self._world, self.size
        sizes = [self.size, *(self._optics[name].canvas for name in group.names)]
        group.core = PixelCameras(
            world.model,
            world.copies,
            world.core.threads,
            [self._optics[name].id for name in group.names],
            width=width,
            height=height,
            is_grayscale=self.pixels.grayscale,
            stack=self.pixels.stack,
            lenses=[self._optics[name].lens for name in group.names],
            quality=self._quality,
            max_width=max(size[0] for size in sizes),
            max_height=max(size[1] for size in sizes),
        )
        if group.is_regular:
            group.core.watch(world.core)
        group.next = self._room(group)
        group.core.turn(group.next, None)

    def _room(self, group: _Group) -> list[NDArray[np.uint8]]:
        """Return arrays for the next frames: new ones, or expired ones."""
        valid = self.pixels.valid_steps
        # A step in which an episode ends and the next one starts has two observations.
        if valid is None or len(group.used) < 2 * valid + 1:
            room = [np.empty(self._shape, np.uint8) for _ in group.names]
        else:
            room = group.used.pop(0)
        if valid is not None:
            group.used.append(room)
        return room

    def close(self) -> None:
        """Release the renderers, which the world keeps until it is closed. Closing twice is harmless."""
        for group in self._groups:
            group.core = None


class _Group:
    """Cameras that are drawn together."""

    def __init__(self, names: list[str], *, is_regular: bool) -> None:
        self.names = names
        self.is_regular = is_regular
        self.core: PixelCameras | None = None
        self.last: list[NDArray[np.uint8]] = []
        """The stacks of the last read, an array (copies, channels, height, width) for each camera."""
        self.next: list[NDArray[np.uint8]] = []
        """Arrays of the next stacks."""
        self.used: list[list[NDArray[np.uint8]]] = []
        """Arrays that are used in turn, the oldest first."""

    def turn(self, room: list[NDArray[np.uint8]]) -> None:
        """Make the drawn frames the last ones, and draw the next into other arrays."""
        assert self.core is not None
        self.last, self.next = self.next, room
        self.core.turn(self.next, self.last)

    def go_on(self, last: list[NDArray[np.uint8]]) -> None:
        """Go on from other stacks."""
        assert self.core is not None
        self.last = last
        self.core.turn(self.next, self.last)
