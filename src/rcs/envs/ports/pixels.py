"""The port of simulated cameras that are observed for learning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from gymnasium import spaces

from rcs.envs import spaces as keys
from rcs.envs.ports.port import Port
from rcs.envs.ports.simulated import delay_of, is_late
from rcs.envs.spaces import Arrays, Observation
from rcs.envs.variation.randomiser import Randomiser
from rcs.sim.camera import Quality
from rcs.sim.camera_feed import DelayedFrames
from rcs.sim.frame_clock import FrameClock
from rcs.sim.pixels import PixelFeed, Pixels
from rcs.sim.scene import CameraPlacement
from rcs.sim.world import World


class PixelPort(Port):
    """All cameras of a scene as stacks of frames with channels first, drawn by the threads that step."""

    memory = ("_feed",)

    def __init__(
        self,
        world: World,
        cameras: Sequence[CameraPlacement],
        clock: FrameClock,
        pixels: Pixels,
        randomiser: Randomiser | None = None,
        *,
        size: tuple[int, int],
        quality: Quality = "fast",
    ) -> None:
        """Use the cameras of a world.

        Args:
            world: The world.
            cameras: Cameras of its scene.
            clock: Says when each has a new frame.
            pixels: What is made of the frames.
            randomiser: Has the latency of frames, if that varies.
            size: Width and height of a frame [px].
            quality: Rendering quality.

        Raises:
            InvalidSetup: A camera's distortion cannot be drawn.
        """
        if is_late(randomiser):
            pixels = replace(pixels, valid_steps=None)  # frames on their way are kept
        self.feed = feed = PixelFeed(world, cameras, clock, pixels, size=size, quality=quality)
        """Draws."""
        self.timed = tuple(f"{keys.FRAMES}/{name}" for name in feed.names)
        self._feed: PixelFeed | DelayedFrames = feed
        self._delay = delay_of(randomiser, feed, clock, world, feed.names)
        if self._delay is not None:
            self.memory = ()  # what is on its way is not kept
            self._feed = self._delay
        self.action_spaces = {}
        box = keys.pixels_space(pixels.channels, *size)
        frames: dict[str, spaces.Space[Any]] = {name: spaces.Dict({keys.PIXELS: box}) for name in feed.names}
        self.observation_spaces = {keys.FRAMES: spaces.Dict(frames)}

    def observe(self) -> Observation:
        """Return the newest stack of every camera."""
        return {keys.FRAMES: self._feed.read()}

    def ages(self) -> dict[str, Any]:
        """Return how old each camera's newest frame is in simulated time, where frames arrive late [s], (*leading,)."""
        return {} if self._delay is None else {f"{keys.FRAMES}/{name}": age for name, age in self._delay.ages.items()}

    def capture_times(self) -> dict[str, Any]:
        """Return when each camera's frames were read."""
        return {f"{keys.FRAMES}/{name}": time for name, time in self._feed.capture_times.items()}

    def command(self, action: Arrays) -> None:
        """Do nothing: a camera takes no commands."""

    def close(self) -> None:
        """Let go of frames on their way."""
        self._feed.close()
