"""Find the agent that can do the task of an environment."""

from __future__ import annotations

import pkgutil
from typing import Any

from rcs.agents.agent import Agent
from rcs.devices import lookup
from rcs.envs.env import Env
from rcs.errors import InvalidSetup


def expert_for(env: Env) -> Agent:
    """Return the expert that an environment's task names.

    Args:
        env: The environment that it will act in.

    Raises:
        InvalidSetup: The task names none.
        UnknownName: The task names one that is not installed.
    """
    task = lookup.find("task", env.setup.task)
    expert: Any = task.expert
    if expert is None:
        raise InvalidSetup(
            f"There is no scripted expert for the task {task.__name__!r}: it names none. Set its class attribute "
            f"`expert`, for example to one of {', '.join(map(repr, lookup.names('agent')))}."
        )
    if isinstance(expert, str):
        expert = pkgutil.resolve_name(expert) if ":" in expert else lookup.find("agent", expert)
    return expert(env)
