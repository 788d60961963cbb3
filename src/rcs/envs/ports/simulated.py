"""Ports of simulated arms, grippers, hands, cameras and tactile sensors, for one copy and for many."""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from gymnasium import spaces

from rcs.envs import spaces as keys
from rcs.envs.ports.port import Port, arm_observation_spaces
from rcs.envs.spaces import Arrays, Observation
from rcs.envs.variation.randomiser import Randomiser
from rcs.sim.camera import Quality, SimCameras
from rcs.sim.camera_feed import CameraFeed, FrameClock, RenderThread
from rcs.sim.delayed_frames import DelayedFrames
from rcs.sim.pixels import PixelFeed, Pixels
from rcs.sim.robot import SimRobot
from rcs.sim.scene import CameraPlacement
from rcs.sim.tactile import SimTactile
from rcs.sim.world import World


class SimArmPort(Port):
    """The arm of a simulated robot."""

    def __init__(self, robot: SimRobot) -> None:
        """Use a robot's arm."""
        arm = robot.placement.arm
        box = keys.joints_space(arm.joint_lower, arm.joint_upper)
        self._robot = robot
        self.joint_space = box
        self.action_spaces = {keys.JOINTS: box}
        self.observation_spaces = arm_observation_spaces(box)

    def command(self, action: Arrays) -> None:
        """Set the joint targets."""
        self._robot.command_joints(action[keys.JOINTS])

    def hold(self) -> None:
        """Stop the arm where it is."""
        self._robot.stop()

    def rebase(self) -> None:
        """Go on from the measured joints, also where they were pushed to."""
        self._robot.stop()

    def observe(self) -> Observation:
        """Read joints, velocities and the TCP pose."""
        robot = self._robot
        return {
            keys.JOINTS: robot.joints,
            keys.TQUAT: robot.tcp_tquat,
            keys.XYZRPY: robot.tcp_xyzrpy,
            keys.JOINT_VELOCITIES: robot.joint_velocities,
        }


class SimEffectorPort(Port):
    """The gripper or the hand of a simulated robot."""

    def __init__(self, robot: SimRobot) -> None:
        """Use a robot's end effector."""
        self._robot = robot
        self._is_hand = robot.placement.hand is not None
        key, size = (keys.HAND, len(robot.hand.joints)) if self._is_hand else (keys.GRIPPER, 1)
        self.action_spaces = {key: keys.normalised_space(size)}
        self.observation_spaces = {key: keys.normalised_space(size)}

    def command(self, action: Arrays) -> None:
        """Set the opening, or the targets of the joints."""
        if self._is_hand:
            self._robot.command_hand(action[keys.HAND])
        else:
            self._robot.command_opening(action[keys.GRIPPER])

    def hold(self) -> None:
        """Set the measured joints of a hand as the target; a gripper goes on to hold what is in it."""
        if self._is_hand:
            self._robot.command_hand(self._robot.hand_joints)

    def kept(self) -> Arrays:
        """Return the target of a gripper."""
        return {} if self._is_hand else {keys.GRIPPER: self._robot.opening_target}

    def observe(self) -> Observation:
        """Read the opening, or the joints."""
        robot = self._robot
        return {keys.HAND: robot.hand_joints} if self._is_hand else {keys.GRIPPER: robot.opening}


class _FramesPort(Port):
    """Frames of a feed, which may arrive late."""

    memory = ("_feed",)

    def __init__(
        self,
        feed: CameraFeed | RenderThread | PixelFeed,
        frames: Mapping[str, spaces.Space[Any]],
        clock: FrameClock,
        world: World,
        randomiser: Randomiser | None,
    ) -> None:
        self.timed = tuple(f"{keys.FRAMES}/{name}" for name in frames)
        self.observation_spaces = {keys.FRAMES: spaces.Dict(dict(frames))}
        self._feed: CameraFeed | RenderThread | PixelFeed | DelayedFrames = feed
        self._delay: DelayedFrames | None = None
        if randomiser is not None and _is_late(randomiser):
            latency = functools.partial(randomiser.by_name, "frame_latency", tuple(frames))
            longest, jitter = randomiser.ranges.frame_latency[1], randomiser.ranges.frame_jitter
            self._feed = self._delay = DelayedFrames(feed, clock, world, latency, longest=longest, jitter=jitter)
        if isinstance(feed, RenderThread):
            self.memory = ()  # a thread draws at times of its own

    def observe(self) -> Observation:
        """Return the newest frame of every camera."""
        return {keys.FRAMES: self._feed.read()}

    def ages(self) -> dict[str, Any]:
        """Return the age of each camera's frame in simulated time, where frames arrive late [s], (*leading,)."""
        return {} if self._delay is None else {f"{keys.FRAMES}/{name}": age for name, age in self._delay.ages.items()}

    def capture_times(self) -> dict[str, Any]:
        """Return the time at which each camera's frame was drawn; one that is returned again keeps its time.

        For many copies whose frames arrive late, each has its own times, (copies,).
        """
        return {f"{keys.FRAMES}/{name}": time for name, time in self._feed.capture_times.items()}

    def close(self) -> None:
        """Free the renderer."""
        self._feed.close()


def _is_late(randomiser: Randomiser | None) -> bool:
    fields = ("frame_latency", "frame_jitter")
    return randomiser is not None and any(randomiser.ranges.varies(field) for field in fields)


class SimCameraPort(_FramesPort):
    """All cameras of a scene, drawn together, each at its own frame rate."""

    def __init__(self, cameras: SimCameras, clock: FrameClock, randomiser: Randomiser | None = None) -> None:
        """Use the cameras of a world.

        Args:
            cameras: The cameras.
            clock: Knows when each has a new frame.
            randomiser: Has the latency of frames, if that varies.
        """
        self.cameras = cameras
        is_threaded = cameras.world.stepping == "realtime" and not cameras.world.leading
        feed = RenderThread(cameras, clock) if is_threaded else CameraFeed(cameras, clock)
        entries = [keys.RGB, keys.INTRINSICS, keys.DISTORTION, keys.EXTRINSICS]
        entries += [keys.SEGMENTATION, keys.GEOMS] if cameras.has_segmentation else []
        entries += [keys.DEPTH] if cameras.has_depth else []
        frames = {name: keys.frame_space(entries, size) for name, size in cameras.sizes.items()}
        super().__init__(feed, frames, clock, cameras.world, randomiser)

    @property
    def about(self) -> dict[str, Any]:
        """The calibration of each camera, and the names of the numbers in segmentation."""
        cameras = {
            one.name: {"source": "data sheet"} if one.calibration is None else one.calibration.about()
            for one in self.cameras.placements
        }
        labels = {"labels": self.cameras.labels.to_json()} if self.cameras.has_segmentation else {}
        return {"cameras": cameras, **labels}


class PixelPort(_FramesPort):
    """All cameras of a scene as stacks of frames with channels first, drawn by the threads that step."""

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
            clock: Knows when each has a new frame.
            pixels: How stacks are made of the frames.
            randomiser: Has the latency of frames, if that varies.
            size: Width and height of a frame [px].
            quality: Rendering quality.

        Raises:
            InvalidSetup: A camera's distortion cannot be drawn.
        """
        if _is_late(randomiser):
            pixels = replace(pixels, valid_steps=None)  # frames on their way are kept
        self.feed = PixelFeed(world, cameras, clock, pixels, size=size, quality=quality)
        """Draws the stacks."""
        frame = keys.frame_space([keys.PIXELS], size, channels=pixels.channels)
        super().__init__(self.feed, dict.fromkeys(self.feed.names, frame), clock, world, randomiser)


class SimTactilePort(Port):
    """Tactile sensors of a scene, as `frames`/sensor/`rgb`."""

    def __init__(self, sensors: Sequence[SimTactile]) -> None:
        """Use the sensors of a world."""
        self.sensors = {sensor.placement.name: sensor for sensor in sensors}
        self.timed = tuple(f"{keys.FRAMES}/{name}" for name in self.sensors)
        self._times: dict[str, float] = {}
        frames = {name: keys.frame_space([keys.RGB], one.gel.size) for name, one in self.sensors.items()}
        self.observation_spaces = {keys.FRAMES: spaces.Dict(dict(frames))}

    def observe(self) -> Observation:
        """Read every sensor."""
        frames: Observation = {}
        for name, sensor in self.sensors.items():
            frames[name] = {keys.RGB: sensor.read()[keys.RGB]}
            self._times[f"{keys.FRAMES}/{name}"] = time.perf_counter()
        return {keys.FRAMES: frames}

    def capture_times(self) -> dict[str, float]:
        """Return when each sensor was read."""
        return dict(self._times)

    def close(self) -> None:
        """Free what drawing needed."""
        for sensor in self.sensors.values():
            sensor.close()
