"""The example of a driver in C++ is built as its first lines say, and `rcs.make` drives its arm."""

from __future__ import annotations

import importlib
import os
import subprocess
from collections.abc import Generator
from pathlib import Path
from types import ModuleType

import pytest

from rcs.devices import Arm
from rcs.errors import InvalidSetup
from rcs.robots import UR5E
from rcs.testing import ArmContract

pytestmark = pytest.mark.slow  # what it tests is compiled

PROGRAM = """
import numpy as np, rcs

hardware = {"ur5e": "my_driver:MyDriver:192.0.2.1", "ur5e/gripper": "fake"}
with rcs.make("Free", robot="ur5e", frequency=20, hardware=hardware) as env:
    first, _ = env.reset()
    for _ in range(20):
        seen, *_, info = env.step({"joints": np.full(6, 0.01), "gripper": np.ones(1)})
    print(env.platform["ur5e"], *info["clamped"], np.abs(seen["joints"] - first["joints"] - 0.2).max() < 0.05)
"""


@pytest.fixture(scope="module")
def driver(cpp_driver: Path) -> Generator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(cpp_driver))
        yield importlib.import_module("my_driver")


class TestContract(ArmContract):  # without the loss of the link: this one has none that a test could cut
    """The contract of all arms."""

    tolerance = 5e-3
    stopping_time = 0.5

    @pytest.fixture(autouse=True)
    def _from_the_example(self, driver: ModuleType) -> None:
        self.driver = driver.MyDriver()

    def make_device(self) -> Arm:
        return self.driver.arm("192.0.2.1", UR5E, {})


def test_the_wheel_and_the_example_drive_an_environment(wheel_python: Path, cpp_driver: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(cpp_driver)}
    done = subprocess.run(
        [wheel_python, "-c", PROGRAM], capture_output=True, text=True, env=environment, check=False, timeout=120
    )
    assert done.stdout == "my_driver:MyDriver my arm at 192.0.2.1 True\n", done.stderr


def test_its_options_are_checked(driver: ModuleType) -> None:
    slow = driver.MyDriver().arm("192.0.2.1", UR5E, {"speed": 0.05})
    assert slow.limits.joint_velocity == pytest.approx([0.05 * fastest for fastest in UR5E.velocity_limit])
    with pytest.raises(InvalidSetup, match="share above 0"):
        driver.MyDriver().arm("192.0.2.1", UR5E, {"speed": 0})
    with pytest.raises(InvalidSetup, match="Did you mean 'speed'"):
        driver.MyDriver().arm("192.0.2.1", UR5E, {"sped": 1})
