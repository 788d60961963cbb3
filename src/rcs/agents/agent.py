"""The interface of an agent (a script, a planner, a person at a device, or a policy), and the choice of one."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from rcs.devices import lookup
from rcs.envs.env import Env
from rcs.envs.observer import Note
from rcs.envs.spaces import Action, Observation
from rcs.errors import InvalidSetup

_TRAINED, _SERVED = "rcs.rl.policy:TrainedPolicy", "rcs.policy.agent:ServedPolicy"
"""Classes that a path and an address stand for; by name, for their modules need packages that are not always there."""

Event = Literal["start", "success", "failure", "discard", "reset", "takeover", "stop"]
"""Requests of a person besides motion: a take that begins, or ends with a verdict or without a trace; the next episode;
a policy's robot, or to give it back; the end."""

ACTOR = Note("actor", words=("policy", "person"))
"""Note of who acted in a row, where a person may."""


class Agent(ABC):
    """Maps an observation to an action. Agents for an environment are made by a factory: `PickExpert(env)`."""

    rate: float | None = None
    """Rate of decisions [Hz]; None for once per step of the environment."""

    @abstractmethod
    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin an episode with its first observation."""

    @abstractmethod
    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the next action."""

    @property
    def weights(self) -> str | None:
        """SHA-256 of the weights that act; None if there are none, or that is not known."""
        return None

    @property
    def is_lost(self) -> bool:
        """True if the connection to who decides was lost in this episode, so that its end says nothing about them."""
        return False

    @property
    def latencies(self) -> Sequence[float]:
        """How long each answer of a policy took in this episode [s]."""
        return ()

    def lead_only(self, robot: str) -> None:  # noqa: B027  most agents only answer
        """Act for one robot of several; the others have agents of their own, and go on when it has to hold."""

    def close(self) -> None:  # noqa: B027  most agents hold nothing
        """Release devices, threads and connections. Closing twice is harmless."""

    @property
    def failure(self) -> str | None:
        """Why the agent gave up, as a class such as `ik` or `no_contact`; None if it has not."""
        return None

    @property
    def failure_message(self) -> str | None:
        """Words on what went wrong in this episode, for people to read; None if the class says it all."""
        return None

    @property
    def note_fields(self) -> Sequence[Note]:
        """Fields that `notes` may have, for recordings."""
        return ()

    def notes(self) -> Mapping[str, Any]:
        """Return notes to record with the last action: who acted, latency [s], place in a chunk."""
        return {}

    def events(self) -> Sequence[Event]:
        """Return a person's requests since the last call, oldest first."""
        return ()


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
        agent = expert_of(env.setup.task)
    elif (policy := policy_at(agent)) is not None:
        return policy(env)
    found = lookup.find("agent", agent)
    made = found if isinstance(found, Agent) else found(env) if callable(found) else None
    if not isinstance(made, Agent):
        raise InvalidSetup(f"The agent {agent!r} is {made!r}; valid is a class or function that makes an Agent.")
    return made


def expert_of(task: str) -> Any:
    """Return the scripted expert that a task names.

    Raises:
        InvalidSetup: It names none.
        UnknownName: There is no such task.
    """
    found = lookup.find("task", task)
    if found.expert is None:
        raise InvalidSetup(
            f"There is no scripted expert for the task {found.__name__!r}: it names none. Give an agent, or set the "
            f"task's attribute `expert`, for example to one of {', '.join(map(repr, lookup.names('agent')))}."
        )
    return found.expert


def policy_at(given: Any) -> Any:
    """Return the policy, a factory of agents, that an agent's path or address stands for; None for another agent."""
    if is_path(given):
        return lookup.find("agent", _TRAINED)(str(given))
    is_address = isinstance(given, str) and "://" in given
    return lookup.find("agent", _SERVED)(address=given) if is_address else None


def is_path(given: Any) -> bool:
    """Return whether an agent or a task is given as the path of a checkpoint or a run, not by name.

    A word that is the name of one is no path, even if a folder here has the same name.
    """
    if isinstance(given, Path):
        return True
    if not isinstance(given, str) or ":" in given:
        return False
    return os.sep in given or (Path(given).is_dir() and given not in (*lookup.names("task"), *lookup.names("agent")))
