"""A policy that leads joints along a function of time, and agents' steps in an environment, for tests."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from vlagents import Chunk, Metadata, Observation, PartSpec, Policy

from rcs.envs import Env
from rcs.policy import ChunkAgent

JOINTS = PartSpec("joints", 7, "rad")
GRIPPER = PartSpec("gripper", 1, "0 closed, 1 open")


class Swing(Policy):
    """Leads the joints along a function of time from where they were first seen; keeps what it was shown and told."""

    def __init__(self, *, rate: float = 30.0, horizon: int = 16, meaning: str = "absolute", unit: str = "rad") -> None:
        joints = replace(JOINTS, meaning=meaning, unit=unit)  # type: ignore[arg-type]
        self.told = Metadata(
            name="swing", state=(replace(JOINTS, unit=unit),), action=(joints, GRIPPER), rate=rate, horizon=horizon
        )
        self.seen: list[Observation] = []
        self.resets: list[tuple[str, str, int | None]] = []
        self.start = np.zeros(7)
        self.error: Exception | None = None

    def metadata(self) -> Metadata:
        return self.told

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        self.resets.append((session, instruction, seed))
        self.first: float | None = None
        if self.error is not None:
            raise self.error

    def infer(self, observation: Observation) -> Chunk:
        if self.error is not None:
            raise self.error
        self.seen.append(observation)
        if self.first is None:
            self.first, self.start = observation.time, observation.state["joints"]
        ends = observation.time - self.first + (1 + np.arange(self.told.horizon)) / self.told.rate
        scale = 180 / np.pi if self.told.action[0].unit == "deg" else 1.0
        if self.told.action[0].meaning == "delta":
            rows = np.full((self.told.horizon, 7), scale * 0.3 / self.told.rate)
        else:
            rows = self.start + scale * 0.3 * ends[:, None]
        return Chunk(np.hstack([rows, np.ones((len(rows), 1))]), 1 / self.told.rate, observation.time)


def rollout(env: Env, agent: ChunkAgent, steps: int, seed: int = 0) -> list[tuple[Any, Any, Any]]:
    observation, info = env.reset(seed=seed)
    agent.reset(observation, info)
    rows = []
    for _ in range(steps):
        action = agent.act(observation, info)
        observation, _, _, _, info = env.step(action)
        rows.append((action, observation, agent.notes()))
    return rows
