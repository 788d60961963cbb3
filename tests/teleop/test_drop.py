"""A device that dies in mid-motion: the robot is at rest soon, and stays until the clutch is pressed anew."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs import Env
from rcs.kinematics import kinematics_of
from rcs.teleop import HandReading, Operator
from tests.teleop.scripted_device import ScriptedDevice, at, held

pytestmark = pytest.mark.slow

AT_REST = 1e-3
"""Way for which an arm at rest may still settle [m]."""
AFTER = 0.1
"""Time after `valid_for` within which it is at rest [s]."""


def moving(t: float) -> HandReading:
    return held(at(0.0, 0.1 * max(t - 0.3, 0.0), 1.0), *(("clutch",) if t > 0.3 else ()))


class Loop:
    """A loop in real time that knows where the TCP was at which moment."""

    def __init__(self, hardware: Any, **setup: Any) -> None:
        stepping = {} if hardware else {"stepping": "realtime"}
        self.env: Env = rcs.make(
            "Free", hardware=hardware, max_episode_steps=None, control="tquat", relative="absolute", **stepping, **setup
        )
        self.device = ScriptedDevice(moving, is_waiting=True)
        self.operator = Operator(self.env, self.device)
        self.observation, self.info = self.env.reset(seed=0)
        self.operator.reset(self.observation, self.info)
        self.times: list[float] = []
        self.places: list[np.ndarray] = []

    def run(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.observation, _, _, _, self.info = self.env.step(self.operator.act(self.observation, self.info))
            self.times.append(time.monotonic())
            self.places.append(np.array(self.observation["tquat"][:3]))

    def begin_to_move(self) -> None:
        """Press the clutch and move; anew where a busy machine holds threads up for longer than a reading is valid."""
        for _ in range(20):
            began = self.device.clock() - self.device.start
            self.device.script = lambda t, began=began: moving(t - began)
            self.run(0.9)
            if self.operator.states == {"right": "engaged"} and self.speed_before(time.monotonic()) > 0.02:
                return
        pytest.fail("the machine is too busy for a loop of 30 Hz")

    def moved_after(self, moment: float) -> float:
        """Return the way of the TCP from a moment on [m]."""
        places = np.array([place for when, place in zip(self.times, self.places, strict=True) if when >= moment])
        return float(np.linalg.norm(places - places[0], axis=1).max())

    def speed_before(self, moment: float) -> float:
        rows = [i for i, when in enumerate(self.times) if when <= moment][-3:]
        way = np.linalg.norm(self.places[rows[-1]] - self.places[rows[0]])
        return float(way / (self.times[rows[-1]] - self.times[rows[0]]))


@pytest.fixture(params=[None, "sim"], ids=["simulation", "hardware"])
def loop(request: pytest.FixtureRequest) -> Iterator[Loop]:
    made = Loop(request.param)
    yield made
    made.operator.close()
    made.env.close()


@pytest.mark.parametrize("fate", ["silent", "lost", "hangs", "untracked", "leaps"])
def test_the_robot_is_at_rest_soon_after_its_device_is_dead(loop: Loop, fate: str) -> None:
    loop.begin_to_move()
    died = time.monotonic()
    if fate in ("untracked", "leaps"):
        gone = HandReading(is_tracked=False) if fate == "untracked" else held(at(0.0, 1.0, 1.0), "clutch")
        loop.device.script = lambda t: gone
    else:
        loop.device.fate = fate
    loop.run(0.8)
    assert loop.operator.states == {"right": "held"}
    assert loop.moved_after(died + loop.device.valid_for + AFTER) < AT_REST
    # It is back, with the clutch still pressed: nothing moves until that is pressed anew.
    loop.device.fate, loop.device.script = "", lambda t: held(at(0.0, 0.1 * t, 1.0), "clutch")
    back = time.monotonic()
    loop.run(1.5)
    assert loop.operator.states == {"right": "held"}
    assert loop.moved_after(back) < 1e-4
    began = loop.device.clock() - loop.device.start
    loop.device.script = lambda t: held(
        at(0.0, 0.3 * max(t - began - 0.3, 0.0), 1.0), *(("clutch",) if t > began + 0.2 else ())
    )
    loop.run(0.7)
    assert loop.operator.states == {"right": "engaged"}
    assert 0.02 < loop.moved_after(back) < 0.25 * 0.7


def test_a_loop_that_hangs_holds_real_devices() -> None:
    loop = Loop("sim")
    try:
        arm: Any = loop.env.stack.ports[0].device
        robot = loop.env.robots["fr3"]
        kinematics = kinematics_of(robot.arm, robot.end_effector)
        kinematics.forward(np.array(arm.state().joints))
        loop.begin_to_move()
        hung = time.monotonic()
        loop.times, loop.places = [], []
        while time.monotonic() < hung + 1.0:
            loop.times.append(time.monotonic())
            loop.places.append(kinematics.forward(np.array(arm.state().joints)).tquat[:3])
            time.sleep(0.01)
        assert loop.moved_after(hung) > 1e-3
        assert loop.moved_after(hung + loop.device.valid_for + AFTER) < AT_REST
    finally:
        loop.operator.close()
        loop.env.close()
