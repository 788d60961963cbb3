"""An agent that stays where its robot is, and asks for things, for tests."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rcs.agents import Agent, Event, Guide
from rcs.envs import Env
from rcs.envs.observer import Note
from rcs.envs.spaces import Action, Observation


class Asking(Agent):
    """Stays where the robot is, counts, and asks for things at given steps."""

    def __init__(self, env: Env, requests: Mapping[int, Event], *, rate: float | None = None) -> None:
        (robot,) = env.robots.values()
        self.guide, self.requests, self.rate = Guide(env, robot), dict(requests), rate
        self.steps = self.decisions = 0
        self.told: list[str] = []
        """Its instructions, one per reset."""

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        self.guide.reset(observation)
        self.told.append(info["instruction"])

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        self.decisions += 1
        return self.guide.act(observation, info)

    def notes(self) -> Mapping[str, Any]:
        return {"input_time": time.monotonic() - 0.01, "mood": "calm", "place": np.arange(3.0)}

    @property
    def note_fields(self) -> Sequence[Note]:
        return [Note("input_time", unit="s"), Note("mood", words=("calm", "angry")), Note("place", size=3, unit="m")]

    def events(self) -> Sequence[Event]:
        self.steps += 1
        return [self.requests.pop(self.steps)] if self.steps in self.requests else []
