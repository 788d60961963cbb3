"""Every kind of environment that the project makes keeps the contract."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import pytest

import rcs
from rcs.testing import EnvContract


class Made(EnvContract):
    """An environment of `rcs.make`."""

    options: ClassVar[dict[str, Any]]
    longest_episode = 6

    def make_env(self) -> Any:
        return rcs.make(**{"max_episode_steps": 6, **self.options})


class TestPickCuboidWithRelativeJoints(Made):
    options: ClassVar[dict[str, Any]] = {"task": "PickCuboid"}


class TestPickCuboidWithAbsoluteJoints(Made):
    options: ClassVar[dict[str, Any]] = {"task": "PickCuboid", "relative": False}


class TestPickCuboidWithRelativePoses(Made):
    options: ClassVar[dict[str, Any]] = {"task": "PickCuboid", "control": "tquat"}


class TestPickCuboidWithAbsolutePoses(Made):
    options: ClassVar[dict[str, Any]] = {"task": "PickCuboid", "control": "tquat", "relative": False}


class TestFreeWithRelativeRollPitchYaw(Made):
    options: ClassVar[dict[str, Any]] = {"task": "Free", "control": "xyzrpy"}


class TestFreeWithAbsoluteRollPitchYaw(Made):
    options: ClassVar[dict[str, Any]] = {"task": "Free", "control": "xyzrpy", "relative": "absolute"}


class TestFreeWithPosesRelativeToAnOrigin(Made):
    options: ClassVar[dict[str, Any]] = {"task": "Free", "control": "tquat", "relative": "origin"}


class TestPickCuboidWithTwists(Made):
    options: ClassVar[dict[str, Any]] = {"task": "PickCuboid", "control": "twist"}


class TestTwoRobotsWithTwists(Made):
    options: ClassVar[dict[str, Any]] = {"task": "Free", "robot": "dual_fr3", "control": "twist"}


class TestFreeWithSynchronousSteps(Made):
    options: ClassVar[dict[str, Any]] = {"task": "Free", "stepping": "sync", "binary_gripper": False}


class TestPush(Made):
    options: ClassVar[dict[str, Any]] = {"task": "Push"}


class TestHardestPickCuboid(Made):
    options: ClassVar[dict[str, Any]] = {
        "task": "PickCuboid",
        "task_options": {"distractors": 2, "pose": "any", "edges": "random", "area": "large"},
    }


class TestLiftBarWithTwoRobots(Made):
    options: ClassVar[dict[str, Any]] = {"task": "LiftBar", "robot": "dual_fr3"}


class TestTwoRobotsWithAbsolutePoses(Made):
    options: ClassVar[dict[str, Any]] = {"task": "Free", "robot": "dual_fr3", "control": "tquat", "relative": False}


class TestRandomisedPickCuboid(Made):
    options: ClassVar[dict[str, Any]] = {"task": "PickCuboid", "randomisation": True}


@pytest.mark.gl
class TestPickCuboidWithCameras(Made):
    steps = 2
    options: ClassVar[dict[str, Any]] = {
        "task": "PickCuboid",
        "cameras": rcs.Cameras(names=("wrist", "side"), image_size=(24, 16), depth=True),
    }


class TestUR5eWithTactileSensors(Made):
    steps = 2
    options: ClassVar[dict[str, Any]] = {"task": "PickCuboid", "robot": "ur5e", "tactile": "digit"}


class TestSO101WithTactileSensors(Made):
    steps = 2
    options: ClassVar[dict[str, Any]] = {"task": "PickCuboid", "robot": "so101", "tactile": "digit"}


class TestFakeDevices(EnvContract):
    longest_episode = 20
    is_reset_complete = False  # a reset opens the devices and moves nothing

    @pytest.fixture(autouse=True)
    def _on_a_bench(self, make_bench: Callable[..., Any]) -> None:
        self.make_bench = make_bench

    def make_env(self) -> Any:
        return self.make_bench().env


class TestFakeDevicesWithSynchronousSteps(TestFakeDevices):
    def make_env(self) -> Any:
        return self.make_bench(is_synchronous=True).env


class TestFakeDevicesOfTwoRobots(TestFakeDevices):
    def make_env(self) -> Any:
        return self.make_bench(robots=("left", "right")).env
