"""One rollout: an agent acts in an environment until the episode is over."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rcs.agents import Agent
from rcs.envs.env import Env
from rcs.envs.spaces import TWIST, Observation
from rcs.envs.step.judge import DIVERGED, FAULT
from rcs.errors import InvalidSetup

OPEN = 0.5
"""A gripper command of at least this opens."""

Judge = Callable[[Observation, Mapping[str, Any]], bool | None]
"""Returns whether the task was done, by the last observation and info; None if that is not known."""


@dataclass(frozen=True, kw_only=True)
class EpisodeResult:
    """The result of an episode."""

    seed: int | None
    steps: int
    success: bool | None
    """True if the task was done; None without a verdict, as on devices or after a fault."""
    failure: str | None
    """Class of the failure: `fault` of a device, `diverged` of the simulation, or one of the agent; None otherwise."""
    reward: float
    """Sum over the episode."""
    message: str | None = None
    """The agent's message about a problem, even if the task was done in the end; None without one."""

    def outcome(self) -> dict[str, Any]:
        """Return the outcome to store, besides success and seed."""
        return {"failure": self.failure, "reward": self.reward}


def run_episode(
    env: Env,
    agent: Agent,
    *,
    seed: int | None = None,
    options: Mapping[str, Any] | None = None,
    judge: Judge | None = None,
    on_step: Callable[[], None] | None = None,
    max_steps: int | None = None,
) -> EpisodeResult:
    """Run one episode.

    If an error of the agent or Ctrl-C ends it, all devices hold; real ones hold at any other end, too.

    Args:
        env: The environment.
        agent: The agent, which acts until the end, or until its event `stop`, at which all devices hold. If it decides
            at a lower rate than the environment, its last action is repeated; its notes are given to observers with the
            steps in which it decided.
        seed: Seed of the reset.
        options: Options of the reset.
        judge: Returns whether the task was done, in the place of the task; not called after a fault.
        on_step: Called after the reset and after every step.
        max_steps: Largest number of steps, besides the environment's limit; None for no limit.

    Raises:
        InvalidSetup: The agent's rate does not divide the environment's, its repeated actions would add up, or
            `max_steps` is below 1.
    """
    if max_steps is not None and max_steps < 1:
        raise InvalidSetup(f"max_steps is {max_steps!r}; valid is a whole number from 1, or None.")
    every = _steps_per_decision(env, agent)
    observation, info = env.reset(seed=seed, options=options)
    steps, total, was_touched_early, is_over = 0, 0.0, False, False
    action: dict[str, Any] = {}
    try:
        agent.reset(observation, info)
        while not is_over:
            if on_step is not None:
                on_step()
            if steps % every == 0:
                action = agent.act(observation, info)
                env.note(**agent.notes())
            observation, reward, terminated, truncated, info = env.step(action)
            steps += 1
            total += float(reward)
            was_touched_early |= bool(info.get("is_touched", False)) and _is_open(action)
            is_over = terminated or truncated or steps == max_steps
            if not is_over and "stop" in agent.events():
                is_over = True
                env.hold()
        if on_step is not None:
            on_step()
    except BaseException:
        env.hold()  # the last command must not go on unsupervised
        raise
    is_simulated = set(env.platform.values()) == {"simulation"}
    if not is_simulated and info["end"] != FAULT:
        env.hold()  # real devices are in motion still, while the episode is judged and the next one prepared
    if info["end"] == FAULT:
        # A device that fails says nothing about the agent; a simulated arm fails because of what the agent did.
        success = False if is_simulated else None
        return EpisodeResult(seed=seed, steps=steps, success=success, failure=FAULT, reward=total)
    if info["end"] == DIVERGED:
        return EpisodeResult(seed=seed, steps=steps, success=False, failure=DIVERGED, reward=total)
    verdict = info.get("success")
    success = judge(observation, info) if judge is not None else None if verdict is None else bool(verdict)
    failure = (agent.failure or ("collision" if was_touched_early else "timeout")) if success is False else None
    return EpisodeResult(
        seed=seed, steps=steps, success=success, failure=failure, reward=total, message=agent.failure_message
    )


def randomisation_of(env: Env) -> dict[str, Any]:
    """Return the outcome's entry about the randomisation of the present episode; empty if there is none."""
    drawn = {field: values.tolist() for field, values in env.simulation.randomisation.items()}
    return {"randomisation": drawn} if drawn else {}


def ask(observation: Observation, info: Mapping[str, Any]) -> bool | None:
    """Judge an episode by asking the person at the terminal."""
    answer = ""
    while answer not in ("y", "n", "?"):
        answer = input("Was the task done? [y]es, [n]o, [?] not known: ").strip().lower()[:1]
    return {"y": True, "n": False, "?": None}[answer]


def _steps_per_decision(env: Env, agent: Agent) -> int:
    if agent.rate is None:
        return 1
    every = round(env.frequency / agent.rate)
    if every < 1 or abs(env.frequency - every * agent.rate) > 1e-6 * env.frequency:
        raise InvalidSetup(
            f"{type(agent).__name__} decides at {agent.rate:g} Hz and the environment steps at {env.frequency:g} Hz; "
            "its frequency must be a multiple of the agent's rate."
        )
    if every > 1 and env.setup.relative == "last_step" and env.setup.control != TWIST:
        raise InvalidSetup(
            f"{type(agent).__name__} decides at {agent.rate:g} Hz; in between its actions are repeated, and those "
            "relative to the last step would add up. Use relative='absolute' or 'origin'."
        )
    return every


def _is_open(action: Mapping[str, Any]) -> bool:
    """Return whether the gripper was commanded to be open, so that touching something is a collision."""
    parts = list(action.values()) if all(isinstance(value, Mapping) for value in action.values()) else [action]
    return all("gripper" in part and float(np.min(part["gripper"])) >= OPEN for part in parts)
