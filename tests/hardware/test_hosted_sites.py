"""Which devices have a host, where hosts are found, and environments on devices with one."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from unruly import UnrulyDriver, drop

import rcs
from rcs.devices import Arm
from rcs.errors import InvalidSetup
from rcs.hardware import Site, hosted
from rcs.hardware.franka import FrankaDriver
from rcs.hardware.robotiq import RobotiqDriver
from rcs.hardware.so101 import So101Driver
from rcs.hardware.tilburg import TilburgDriver
from rcs.hardware.ur import UrDriver
from rcs.hardware.xarm import XarmDriver
from rcs.robots.fr3 import FR3
from tests.hardware.hosting import HOME, made, unruly_arm


def test_a_driver_says_whether_its_devices_have_a_host_and_a_site_may_say_otherwise() -> None:
    def arm(driver: str, **options: Any) -> Arm:
        site = Site(arms={"fr3": {"driver": driver, "options": options}})
        return site.devices({"fr3": (FR3, None)}, {}).arms["fr3"]

    assert UnrulyDriver.hosted
    assert type(arm("unruly:UnrulyDriver")).__name__ == "HostedArm"
    assert type(arm("unruly:UnrulyDriver", host=False)).__name__ == "UnrulyArm"
    assert type(arm("fake")).__name__ == "FakeArm"
    assert type(arm("fake", host=True)).__name__ == "HostedArm"
    assert type(arm("sim", host=False)).__name__ == "StandInArm"
    for driver in (FrankaDriver, RobotiqDriver, So101Driver, TilburgDriver, UrDriver, XarmDriver):  # vendors' libraries
        assert driver.hosted
    with pytest.raises(InvalidSetup, match="'host' is 'yes'; valid is true or false"):
        arm("fake", host="yes")


def test_all_programs_of_a_user_look_for_hosts_in_one_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(hosted.FOLDER)
    found = hosted.folder()
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    assert hosted.folder() == found
    assert found.name == f"rcs-{os.getuid()}"


def test_an_environment_runs_on_devices_with_a_host(tmp_path: Path) -> None:
    given = {"driver": "unruly:UnrulyDriver", "address": "env", "options": {"box": str(tmp_path)}}
    with rcs.make("Free", robot="fr3", hardware={"fr3": given}, relative=False) as env:
        observation, _ = env.reset()
        action = {"joints": observation["joints"] + 0.01, "gripper": np.ones(1, np.float32)}
        for _ in range(5):
            observation, *_ = env.step(action)
        assert np.abs(observation["joints"] - HOME).max() > 1e-3
        drop(tmp_path, "state", "abort")
        for _ in range(100):
            *_, truncated, info = env.step(action)
            if truncated:
                break
        assert "ended with signal 6" in str(info["faults"])


def test_a_streamed_arm_in_a_host_plans_for_the_rate_of_commands_and_counts_what_it_did_not_do() -> None:
    arm = made("arm", "unruly:ServoDriver", "servo", FR3)
    options: Any = {"robot": "fr3", "end_effector": "none", "relative": "absolute", "frequency": 50.0}
    with rcs.make("Free", hardware={"fr3": arm}, **options) as env:
        env.reset()
        for ahead in (0.0, 0.0, 1.0, -1.0, 1.0):
            *_, info = env.step({"joints": HOME + 0.05 * ahead})
        assert arm.state().mode == "0.0200"
        assert info["clamped"]["fr3"]["acceleration"] > 0
        for wrong in (1e-3, np.nan):
            with pytest.raises(InvalidSetup, match="from one tick"):
                arm.period = wrong


def test_an_arm_in_a_host_that_is_not_streamed_counts_nothing(tmp_path: Path) -> None:
    arm = unruly_arm(tmp_path)
    assert not arm.is_streamed
    with pytest.raises(InvalidSetup, match="of a streamed arm"):
        arm.period = 1 / 30
