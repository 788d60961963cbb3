"""Two agents in one environment: each robot does what its own says, at its own rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import Agent, Event, PerRobot
from rcs.envs.observer import Note
from rcs.envs.spaces import Action, Observation
from rcs.errors import InvalidSetup


class Counting(Agent):
    """Moves all robots by its own number of radians per decision, and counts."""

    def __init__(self, step: float, rate: float | None = None, *, is_nested: bool = True) -> None:
        self.step, self.rate, self.is_nested = step, rate, is_nested
        self.decisions, self.is_closed = 0, False

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        self.start = {name: np.array(observation[name]["joints"]) for name in ("left", "right")}
        self.decisions = 0

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        self.decisions += 1
        own = {
            name: {"joints": start + self.step * self.decisions, "gripper": np.ones(1, np.float32)}
            for name, start in self.start.items()
        }
        return own if self.is_nested else own["right"]

    @property
    def note_fields(self) -> Sequence[Note]:
        return [Note("count")]

    def notes(self) -> Mapping[str, Any]:
        return {"count": self.decisions}

    def events(self) -> Sequence[Event]:
        return ("discard",) if self.rate else ()

    def close(self) -> None:
        self.is_closed = True


def test_each_robot_does_what_its_own_agent_says_at_its_own_rate() -> None:
    env = rcs.make("Free", robot="dual_fr3", relative="absolute")
    quick, slow = Counting(0.001), Counting(-0.002, rate=10.0, is_nested=False)
    agent = PerRobot(env, {"left": quick, "right": slow})
    observation, info = env.reset(seed=0)
    agent.reset(observation, info)
    for i in range(7):
        action = agent.act(observation, info)
        np.testing.assert_allclose(action["left"]["joints"], quick.start["left"] + 0.001 * (i + 1))
        np.testing.assert_allclose(action["right"]["joints"], slow.start["right"] - 0.002 * (i // 3 + 1))
        counts = {"left/count": i + 1, **({"right/count": i // 3 + 1} if i % 3 == 0 else {})}
        assert agent.notes() == {"left/actor": "policy", "right/actor": "policy", **counts}
        observation, _, _, _, info = env.step(action)
    assert (quick.decisions, slow.decisions) == (7, 3)
    agent.rest("left", observation, info)
    assert "left/actor" not in agent.notes()
    assert [note.name for note in agent.note_fields] == ["left/actor", "left/count", "right/actor", "right/count"]
    assert agent.events() == ["discard"]
    agent.close()
    assert quick.is_closed
    assert slow.is_closed


@pytest.mark.parametrize("names", [("left",), ("left", "middle"), ()])
def test_a_robot_without_an_agent_or_an_agent_without_a_robot_is_refused(names: Sequence[str]) -> None:
    env = rcs.make("Free", robot="dual_fr3")
    with pytest.raises(InvalidSetup, match="one for each robot of several, here 'left', 'right'"):
        PerRobot(env, {name: Counting(0.0) for name in names})


def test_an_environment_of_one_robot_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="several"):
        PerRobot(rcs.make("Free"), {"fr3": Counting(0.0)})


class Served(Counting):
    """Has weights, answers late, and may be lost."""

    is_lost = False
    weights: str | None = "aa"
    latencies = (0.1, 0.2)


def test_what_is_known_of_served_agents_is_that_of_all() -> None:
    left, right = Served(0.0), Served(0.0)
    both = PerRobot(rcs.make("Free", robot="dual_fr3", relative="absolute"), {"left": left, "right": right})
    assert (both.is_lost, list(both.latencies)) == (False, [0.1, 0.2, 0.1, 0.2])
    before = both.weights
    right.weights = "bb"
    assert before is not None and both.weights not in (None, before)
    right.is_lost, right.weights = True, None
    assert (both.is_lost, both.weights) == (True, None)


def test_actions_that_would_add_up_are_refused() -> None:
    env = rcs.make("Free", robot="dual_fr3", relative="last_step")
    with pytest.raises(InvalidSetup, match="would add up"):
        PerRobot(env, {"left": Counting(0.0), "right": Counting(0.0, rate=10.0)})
