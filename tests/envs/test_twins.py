"""Every setup keeps the contract of environments on hardware too: here on fakes, whose clock is moved by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import pytest

import rcs
from rcs.envs.assemble import assemble
from rcs.hardware import FakeDriver, Site
from rcs.robots.description import GripperDescription
from rcs.setups.ids import ids
from rcs.setups.make import resolve
from rcs.testing import EnvContract


def make_twin(clock: Any, **options: Any) -> Any:
    """Make the environment of a setup whose arms, grippers and hands are all fakes."""
    parts = resolve(rcs.Setup(**options))
    driver, site = FakeDriver(clock), Site()
    robots = {robot.name: (robot.arm, robot.end_effector) for robot in parts.robots}
    kinds: dict[str, dict[str, Any]] = {"arms": {}, "grippers": {}, "hands": {}}
    for name, (arm, effector) in robots.items():
        kinds["arms"][name] = driver.arm(name, arm, {})
        kind = "gripper" if isinstance(effector, GripperDescription) else "hand"
        kinds[f"{kind}s"][name] = getattr(driver, kind)(f"{name} {kind}", effector, {})
    site = Site(arms=kinds["arms"], grippers=kinds["grippers"], hands=kinds["hands"])
    return assemble(replace(parts, devices=site.devices(robots, {}), now=clock, sleep=clock.sleep))


class Twin(EnvContract):
    """The fake twin of a setup."""

    options: ClassVar[dict[str, Any]]
    longest_episode = 6
    is_reset_complete = False  # a reset opens the devices and moves nothing

    @pytest.fixture(autouse=True)
    def _with_a_clock(self, clock: Any) -> None:
        self.make_clock = type(clock)

    def make_env(self) -> Any:
        return make_twin(self.make_clock(), max_episode_steps=6, **self.options)


for _name, (_task, _robot) in ids().items():
    for _control in ("joints", "xyzrpy"):
        _title = f"TestTwinOf{_name.removeprefix('rcs/').replace('-', '')}By{_control.title()}"
        globals()[_title] = type(
            _title, (Twin,), {"options": {"task": _task, "robot": _robot, "control": _control}, "__module__": __name__}
        )


@pytest.mark.parametrize("name", ids())
def test_spaces_are_those_of_the_simulation(name: str, clock: Any) -> None:
    task, robot = ids()[name]
    twin, simulated = make_twin(clock, task=task, robot=robot), rcs.make(task, robot=robot)
    assert twin.action_space == simulated.action_space
    assert twin.observation_space == simulated.observation_space
    assert not twin.is_simulated
    assert set(twin.platform.values()) >= {"FakeArm"}
    assert twin.instruction == simulated.instruction
    assert list(twin.robots) == list(simulated.robots)
