"""One rollout: an agent acts in an environment until the episode is over."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rcs.agents import Agent
from rcs.envs.env import FAULT, Env

OPEN = 0.5
"""A gripper that is told at least this opens."""


@dataclass(frozen=True, kw_only=True)
class EpisodeResult:
    """How an episode went."""

    seed: int | None
    steps: int
    success: bool | None
    """Whether the task was done; None where nobody judged, as no task does on devices or after a fault."""
    failure: str | None
    """Class of the failure, `fault` where a device failed; None otherwise."""
    reward: float
    """Sum over the episode."""

    def outcome(self) -> dict[str, Any]:
        """Return what a dataset keeps of it besides success and seed."""
        return {"failure": self.failure, "reward": self.reward}


def run_episode(env: Env, agent: Agent, *, seed: int | None = None) -> EpisodeResult:
    """Run one episode.

    Args:
        env: The environment.
        agent: Acts in it.
        seed: Of the reset.
    """
    observation, info = env.reset(seed=seed)
    agent.reset(observation, info)
    steps, total = 0, 0.0
    was_touched_early = False
    is_over = terminated = False
    while not is_over:
        action = agent.act(observation, info)
        observation, reward, terminated, truncated, info = env.step(action)
        steps += 1
        total += float(reward)
        was_touched_early |= bool(info.get("is_touched", False)) and _is_open(action)
        is_over = terminated or truncated
    if info["end"] == FAULT:
        return EpisodeResult(seed=seed, steps=steps, success=None, failure=FAULT, reward=total)
    success = bool(info["success"]) if "success" in info else None
    failure = agent.failure or ("collision" if was_touched_early else "timeout") if success is False else None
    return EpisodeResult(seed=seed, steps=steps, success=success, failure=failure, reward=total)


def _is_open(action: Mapping[str, Any]) -> bool:
    """Return whether the gripper was told to be open: touching something then is a collision."""
    parts = list(action.values()) if all(isinstance(value, Mapping) for value in action.values()) else [action]
    return all("gripper" in part and float(part["gripper"][0]) >= OPEN for part in parts)
