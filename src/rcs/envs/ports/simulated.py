"""Ports of simulated devices, for one copy of a world and for many."""

from __future__ import annotations

import functools
import time
from collections.abc import Sequence
from typing import Any

from gymnasium import spaces

from rcs.envs import spaces as keys
from rcs.envs.ports.port import Port, arm_observation_spaces
from rcs.envs.spaces import Arrays, Observation
from rcs.envs.variation.randomiser import Randomiser
from rcs.sim.camera import SimCameras
from rcs.sim.camera_feed import CameraFeed, DelayedFrames, RenderThread
from rcs.sim.frame_clock import FrameClock, FrameRate
from rcs.sim.pixels import PixelFeed
from rcs.sim.robot import SimRobot
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


class SimGripperPort(Port):
    """The gripper of a simulated robot."""

    def __init__(self, robot: SimRobot) -> None:
        """Use a robot's gripper."""
        self._robot = robot
        self.action_spaces = {keys.GRIPPER: keys.normalised_space(1)}
        self.observation_spaces = {keys.GRIPPER: keys.normalised_space(1)}

    def command(self, action: Arrays) -> None:
        """Set the opening."""
        self._robot.command_opening(action[keys.GRIPPER])

    def observe(self) -> Observation:
        """Read the opening."""
        return {keys.GRIPPER: self._robot.opening}


class SimHandPort(Port):
    """The hand of a simulated robot."""

    def __init__(self, robot: SimRobot) -> None:
        """Use a robot's hand."""
        self._robot = robot
        size = len(robot.hand.joints)
        self.action_spaces = {keys.HAND: keys.normalised_space(size)}
        self.observation_spaces = {keys.HAND: keys.normalised_space(size)}

    def command(self, action: Arrays) -> None:
        """Set the joint targets."""
        self._robot.command_hand(action[keys.HAND])

    def hold(self) -> None:
        """Set the measured joints as the target."""
        self._robot.command_hand(self._robot.hand_joints)

    def observe(self) -> Observation:
        """Read the joints."""
        return {keys.HAND: self._robot.hand_joints}


class SimCameraPort(Port):
    """All cameras of a scene, drawn together, each at its own frame rate."""

    memory = ("_feed",)

    def __init__(
        self, cameras: SimCameras, clock: FrameClock | None = None, randomiser: Randomiser | None = None
    ) -> None:
        """Use the cameras of a world.

        Args:
            cameras: The cameras.
            clock: Says when each has a new frame; None for the highest rates that they offer for this size.
            randomiser: Has the latency of frames, if that varies.
        """
        if clock is None:
            rates = {one.name: FrameRate.of(one.camera, cameras.sizes[one.name]) for one in cameras.placements}
            clock = FrameClock(cameras.world, rates)
        self.cameras = cameras
        self.timed = tuple(f"{keys.FRAMES}/{name}" for name in cameras.names)
        is_beside_the_loop = cameras.world.stepping == "realtime" and not cameras.world.leading
        feed = RenderThread(cameras, clock) if is_beside_the_loop else CameraFeed(cameras, clock)
        if is_beside_the_loop:
            self.memory = ()  # it draws at times of its own
        self._feed: CameraFeed | RenderThread | DelayedFrames = feed
        self._delay = delay_of(randomiser, feed, clock, cameras.world, cameras.names)
        if self._delay is not None:
            self.memory = ()  # what is on its way is not kept
            self._feed = self._delay
        self.action_spaces = {}
        self.observation_spaces = {keys.FRAMES: cameras_space(cameras)}

    def observe(self) -> Observation:
        """Return the newest frame of every camera."""
        return {keys.FRAMES: self._feed.read()}

    @property
    def about(self) -> dict[str, Any]:
        """How each camera is calibrated, and the names of the numbers in segmentation."""
        cameras = {
            one.name: {"source": "data sheet"} if one.calibration is None else one.calibration.about()
            for one in self.cameras.placements
        }
        labels = {"labels": self.cameras.labels.to_json()} if self.cameras.has_segmentation else {}
        return {"cameras": cameras, **labels}

    def ages(self) -> dict[str, Any]:
        """Return how old each camera's frame is in simulated time, where frames arrive late [s], (*leading,)."""
        return {} if self._delay is None else {f"{keys.FRAMES}/{name}": age for name, age in self._delay.ages.items()}

    def capture_times(self) -> dict[str, Any]:
        """Return when each camera's frame was drawn; one that is returned again keeps its time.

        Of many copies whose frames arrive late, each has its own times, (copies,).
        """
        return {f"{keys.FRAMES}/{name}": time for name, time in self._feed.capture_times.items()}

    def command(self, action: Arrays) -> None:
        """Do nothing: a camera takes no commands."""

    def close(self) -> None:
        """Free the renderer."""
        self._feed.close()


def delay_of(
    randomiser: Randomiser | None,
    feed: CameraFeed | RenderThread | PixelFeed,
    clock: FrameClock,
    world: World,
    names: Sequence[str],
) -> DelayedFrames | None:
    """Return what holds back the frames of a feed, if they are to arrive late."""
    if not is_late(randomiser):
        return None
    assert randomiser is not None, "it is late"
    latency = functools.partial(randomiser.by_name, "frame_latency", tuple(names))
    return DelayedFrames(feed, clock, world, latency, randomiser.ranges.frame_jitter)


def is_late(randomiser: Randomiser | None) -> bool:
    """Return whether frames arrive late."""
    return randomiser is not None and any(
        randomiser.ranges.varies(field) for field in ("frame_latency", "frame_jitter")
    )


class SimTactilePort(Port):
    """Tactile sensors of a scene, as `frames`/sensor/`rgb`."""

    def __init__(self, sensors: Sequence[SimTactile]) -> None:
        """Use the sensors of a world."""
        self.sensors = {sensor.placement.name: sensor for sensor in sensors}
        self.timed = tuple(f"{keys.FRAMES}/{name}" for name in self.sensors)
        self._times: dict[str, float] = {}
        self.action_spaces = {}
        frames = {name: spaces.Dict({keys.RGB: keys.rgb_space(*one.gel.size)}) for name, one in self.sensors.items()}
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

    def command(self, action: Arrays) -> None:
        """Do nothing: a sensor takes no commands."""

    def close(self) -> None:
        """Free what drawing needed."""
        for sensor in self.sensors.values():
            sensor.close()


def cameras_space(cameras: SimCameras) -> spaces.Dict:
    """Return the space of the frames of cameras."""
    return spaces.Dict({name: spaces.Dict(_frame(cameras, *size)) for name, size in cameras.sizes.items()})


def _frame(cameras: SimCameras, width: int, height: int) -> dict[str, spaces.Space[object]]:
    """Return the spaces of a frame of a size [px]."""
    frame: dict[str, spaces.Space[object]] = {keys.RGB: keys.rgb_space(width, height)}
    frame[keys.INTRINSICS] = keys.intrinsics_space()
    frame[keys.DISTORTION] = keys.distortion_space()
    frame[keys.EXTRINSICS] = keys.extrinsics_space()
    if cameras.has_segmentation:
        frame[keys.SEGMENTATION] = frame[keys.GEOMS] = keys.labels_space(width, height)
    if cameras.has_depth:
        frame[keys.DEPTH] = keys.depth_space(width, height)
    return frame
