"""Finds an agent for an environment: a named one, a trained one, or the expert of its task."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from rcs.agents.agent import Agent
from rcs.devices import lookup
from rcs.envs.env import Env
from rcs.errors import InvalidSetup


def agent_for(env: Env, agent: Any = None) -> Agent:
    """Return an agent for an environment.

    Args:
        env: The environment.
        agent: An agent, a class or function that makes one from the environment, the name of an entry point of
            `rcs.agents`, `module:Class`, the path of a checkpoint, or the address of a policy, such as
            `vla://127.0.0.1:8090`; None for the expert that the task names.

    Raises:
        InvalidSetup: The task names no expert, or `agent` does not make an Agent.
        UnknownName: There is no agent of this name.
    """
    if agent is None:
        task = lookup.find("task", env.setup.task)
        agent = task.expert
        if agent is None:
            raise InvalidSetup(
                f"There is no scripted expert for the task {task.__name__!r}: it names none. Give an agent, or set the "
                f"task's attribute `expert`, for example to one of {', '.join(map(repr, lookup.names('agent')))}."
            )
    if is_path(agent):
        return lookup.find("policy", "checkpoint")(agent, env)
    if is_address(agent):
        return lookup.find("policy", "address")(agent, env)
    found = lookup.find("agent", agent)
    made = found if isinstance(found, Agent) else found(env) if callable(found) else None
    if not isinstance(made, Agent):
        raise InvalidSetup(f"The agent {agent!r} is {made!r}; valid is a class or function that makes an Agent.")
    return made


def is_path(given: Any) -> bool:
    """Return whether what is given for an agent or a task is a path, of a checkpoint or of a run, and no name."""
    if isinstance(given, Path):
        return True
    return isinstance(given, str) and ":" not in given and (os.sep in given or Path(given).is_dir())


def is_address(given: Any) -> bool:
    """Return whether what is given for an agent is the address of a policy, and no name."""
    return isinstance(given, str) and "://" in given
