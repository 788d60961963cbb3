"""Laws of a leader arm: where it engages, and how its follower comes to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rcs.teleop import HandReading, LeadOptions
from tests.teleop.scripted_device import Led, held

Lead = Callable[..., Led]


def leader(joints: np.ndarray, *buttons: Any) -> HandReading:
    return held(None, *buttons, joints=joints)


@pytest.mark.parametrize(
    ("apart", "catch_up", "engages"), [(0.15, False, True), (0.4, False, False), (0.4, True, True)]
)
def test_a_leader_begins_near_its_follower_or_lets_it_catch_up(
    lead: Lead, apart: float, catch_up: bool, engages: bool
) -> None:
    goal: list[np.ndarray] = []
    led = lead(
        lambda t: leader(goal[0], *(("clutch",) if t > 0.3 else ())) if goal else None,
        options=LeadOptions(catch_up=catch_up),
    )
    start = np.array(led.observation["joints"])
    goal.append(start + [0.0, 0.0, 0.0, apart, 0.0, 0.0, 0.0])
    led.run(4.0)
    assert led.operator.states == {"right": "engaged" if engages else "released"}
    assert ("0.40 rad from the follower" in led.operator.problem) is not engages
    wanted = goal[0] if engages else start
    np.testing.assert_allclose(led.observation["joints"], wanted, atol=5e-3)
    speeds = np.linalg.norm(np.diff(np.array(led.places)[:, :3], axis=0), axis=1) * 30
    assert speeds.max() < 0.26


def test_a_leader_beyond_a_limit_of_its_follower_is_caught_up_with(lead: Lead) -> None:
    goal: list[np.ndarray] = []
    led = lead(lambda t: leader(goal[0], *(("clutch",) if t > 0.3 else ())) if goal else None)
    guide = led.operator._guides["fr3"]
    start = np.array(led.observation["joints"])
    start[6] = guide.upper[6] - 0.05
    led.observation, led.info = led.env.reset(seed=0, options={"robot": {"joints": start}})
    led.operator.reset(led.observation, led.info)
    goal.append(start + [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1])
    led.run(2.0)
    assert led.operator.states == {"right": "engaged"}
    assert guide.joint_pace == 1.0
    assert led.observation["joints"][6] == pytest.approx(guide.upper[6], abs=0.02)


def test_a_leader_with_other_joints_never_engages_and_says_why(lead: Lead) -> None:
    led = lead(lambda t: leader(np.zeros(6), *(("clutch",) if t > 0.3 else ())))
    led.run(1.0)
    assert "6 joints and the arm 7" in led.operator.problem
    assert led.operator.states == {"right": "released"}


def test_a_leader_without_a_clutch_engages_once_it_rests(lead: Lead) -> None:
    home: list[np.ndarray] = []
    led = lead(
        lambda t: leader(home[0] + (0.1 * np.sin(9.0 * t) if t < 1.0 else 0.0)) if home else None, has_clutch=False
    )
    home.append(np.array(led.observation["joints"]))
    led.run(1.8)
    assert led.operator.states == {"right": "released"}
    led.run(0.6)
    assert led.operator.states == {"right": "engaged"}


def test_a_leader_without_a_clutch_that_nobody_moves_does_not_engage_after_a_hold(lead: Lead) -> None:
    home: list[np.ndarray] = []
    off = [0.0]
    led = lead(lambda t: leader(home[0] + off[0]) if home else None, has_clutch=False)
    home.append(np.array(led.observation["joints"]))

    def lose() -> None:
        led.device.fate = "silent"
        led.run(0.3)
        led.device.fate = ""

    for hold in (lambda: None, lose, lambda: led.operator.reset(led.observation, led.info)):
        hold()
        led.run(1.5)
        assert led.operator.states == {"right": "released"}
        assert led.operator.problem == "right: move the leader, then let it rest"
        off[0] += 0.05
        led.run(1.5)
        assert led.operator.states == {"right": "engaged"}
