"""The identity of an agent: its name, its weights, and the modules of its code."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import sys
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, Protocol, runtime_checkable

from rcs.agents.agent import Agent, expert_of, policy_at
from rcs.devices import lookup
from rcs.envs.env import Env

_OWN = "rcs"
_SOURCES = ("*.py", "*.xml", "*.so")


@dataclass(frozen=True, kw_only=True)
class Identity:
    """The identity of an agent in an evaluation."""

    name: str
    """A name for people, such as `pick@40000`."""
    weights: str | None = None
    """SHA-256 of the weights; None if there are none, or they are unknown."""
    trained: int | None = None
    """Steps that the training had made; None if that is not known."""
    data: str | None = None
    """Hash of the data that it was trained on; None if that is not known."""
    place: str = ""
    """An address, or the path of a checkpoint."""
    policy: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Description that a served policy gives of itself."""
    execution: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """How the chunks of a policy are executed, and the instruction that it receives."""
    modules: tuple[str, ...] = ()
    """Modules of its code."""


@runtime_checkable
class Identified(Protocol):
    """A factory of agents that says who they are, such as a checkpoint or a served policy."""

    def identify(self) -> Identity:
        """Return who acts; of a served policy, as its server says."""
        ...

    def __call__(self, env: Env) -> Agent:
        """Return an agent for an environment."""
        ...


def identity_of(agent: Any, task: str) -> Identity:
    """Return who acts.

    Args:
        agent: As for `agent_for`, or an `Identified`.
        task: The task, whose expert acts if the agent is None.

    Raises:
        InvalidSetup: The task names no expert, there is no checkpoint at the path, or the agent
            is made by something that has no name in a module, such as a lambda or a `functools.partial`.
        UnknownName: There is no agent of this name.
        RcsError: There is no policy at the address.
    """
    policy = policy_at(agent)
    if policy is not None:
        agent = policy
    if isinstance(agent, Identified):
        return agent.identify()
    agent = expert_of(task) if agent is None else agent
    if isinstance(agent, Agent):
        return Identity(name=type(agent).__name__, weights=agent.weights, modules=(type(agent).__module__,))
    found = lookup.find("agent", agent)
    if isinstance(agent, FunctionType) and "<" not in agent.__qualname__:  # not one that another function has made
        agent = f"{agent.__module__}:{agent.__qualname__}"
    if isinstance(agent, str) and not isinstance(found, type):  # the source of its module has all that it is made of
        return Identity(name=agent, modules=(agent.partition(":")[0] if ":" in agent else found.__module__,))
    return Identity(name=lookup.name_of("agent", found), modules=(found.__module__,))


def code_of(modules: Iterable[str]) -> dict[str, str]:
    """Return hashes of the sources of modules by name; those of this package have one hash together.

    Args:
        modules: Names of modules. For one that has no file, such as a notebook, every hash is a new one, so that
            nothing is taken for made by the same code.
    """
    others = sorted({name for name in modules if name.partition(".")[0] != _OWN})
    return {_OWN: _own_code(), **{name: _hash(name) for name in others}}


def _hash(module: str) -> str:
    found = sys.modules.get(module) or importlib.import_module(module)
    path = inspect.getsourcefile(found) if getattr(found, "__file__", None) else None
    if path is None or not Path(path).is_file():
        return f"unknown {uuid.uuid4().hex}"
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


@cache
def _own_code() -> str:
    """Return the hash of all sources of this package, and of its extension."""
    folder, digest = Path(__file__).parents[1], hashlib.sha256()
    extension = Path(str(importlib.import_module(f"{_OWN}._core").__file__))
    found = {path for pattern in _SOURCES for path in folder.rglob(pattern)} - {extension}
    for path in sorted(found):
        digest.update(f"{path.relative_to(folder).as_posix()}\n".encode() + path.read_bytes())
    digest.update(extension.read_bytes())
    return digest.hexdigest()
