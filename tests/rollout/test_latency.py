"""The latency from a hand to the command: which readings count, and for which take."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rcs.envs.observer import Transition
from rcs.rollout.latency import Latency


def row(time: float, **notes: Any) -> Transition:
    return Transition(
        observation={}, action={}, executed={"joints": np.zeros(7)}, reward=0.0, terminated=False, truncated=False,
        info={}, time=time, command_time=time, notes=notes,
    )  # fmt: skip


def test_readings_lead_to_no_command_while_a_policy_acts() -> None:
    latency = Latency()
    latency.on_step(row(1.0, actor="policy", input_time=0.9))
    assert latency.commands == []
    latency.on_step(row(1.1, actor="person", input_time=1.05))
    assert latency.commands == [pytest.approx(0.05)]


def test_the_latency_of_a_take_is_its_own_and_that_of_the_session_is_told() -> None:
    latency = Latency()
    latency.commands = [0.1]
    latency.begin_take()
    latency.commands.append(0.02)
    assert latency.to_json()["command"] == {"count": 1, "median": 0.02, "p99": 0.02}
    assert str(latency) == "event to command: median 60.0 ms, p99 99.2 ms (2)"
