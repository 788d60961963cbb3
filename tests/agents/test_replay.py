"""Replay gives recorded actions back, in order, and no more than there are."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.agents import Replay
from rcs.errors import WrongOrder


def test_actions_come_back_in_order_and_start_again_after_reset() -> None:
    joints = np.arange(6.0).reshape(3, 2)
    agent = Replay({"joints": joints})
    for _ in range(2):
        agent.reset({}, {})
        played = np.array([agent.act({}, {})["joints"] for _ in range(3)])
        np.testing.assert_array_equal(played, joints)


def test_more_actions_than_recorded_are_refused() -> None:
    agent = Replay({"joints": np.zeros((1, 2))})
    agent.act({}, {})
    with pytest.raises(WrongOrder, match="All 1 recorded actions"):
        agent.act({}, {})
