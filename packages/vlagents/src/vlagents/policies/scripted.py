"""A policy of one function, such as a controller or a test."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput
from vlagents.metadata import Metadata
from vlagents.observation import Observation
from vlagents.policy import Policy


class ScriptedPolicy(Policy):
    """Answers with what a function returns for an observation and the session's instruction."""

    def __init__(self, act: Callable[[Observation, str], Any], metadata: Metadata) -> None:
        """Set the function.

        Args:
            act: Takes an observation and the instruction, returns actions (horizon, size) or (size,).
            metadata: What it needs and gives; its `rate` says what time a row is for.

        Raises:
            InvalidInput: The metadata have no rate.
        """
        if metadata.rate <= 0:
            raise InvalidInput(f"rate of {metadata.name!r} is {metadata.rate!r}; valid is a number of hertz above 0.")
        self._act, self._metadata = act, metadata
        self._told: dict[str, str] = {}

    @classmethod
    def load(cls, checkpoint: str) -> ScriptedPolicy:
        """Return the policy that a function makes, given as `module:function`; it has no arguments.

        Raises:
            InvalidInput: There is no such function, or it makes something else.
        """
        module, _, name = checkpoint.partition(":")
        try:
            made = getattr(importlib.import_module(module), name)()
        except (ImportError, AttributeError, ValueError) as error:
            raise InvalidInput(f"checkpoint is {checkpoint!r}; valid is module:function. {error}") from error
        if not isinstance(made, cls):
            raise InvalidInput(f"{checkpoint!r} made {type(made).__name__}; valid is a ScriptedPolicy.")
        return made

    def metadata(self) -> Metadata:
        """Return what was given."""
        return self._metadata

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Remember what is to be done."""
        self._told[session] = instruction

    def infer(self, observation: Observation) -> Chunk:
        """Return what the function says."""
        instruction = observation.instruction or self._told.get(observation.session, "")
        actions = np.atleast_2d(np.asarray(self._act(observation, instruction), np.float64))
        return Chunk(actions, 1.0 / self._metadata.rate, observation.time)

    def forget(self, session: str) -> None:
        """Let go of a session's instruction."""
        self._told.pop(session, None)
