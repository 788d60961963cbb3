"""The interface of a policy, of a server's client, and of wrappers around one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from vlagents.chunk import Chunk
from vlagents.metadata import Metadata
from vlagents.observation import Observation


class Policy(ABC):
    """Answers observations with chunks of actions. Clients and wrappers are policies too, so they nest.

    Examples:
        >>> from vlagents import Observation
        >>> from vlagents.policies.random import RandomPolicy
        >>> policy = RandomPolicy(size=7)
        >>> policy.reset("left arm", "pick up the green cuboid", seed=0)
        >>> policy.infer(Observation(session="left arm")).actions.shape
        (1, 7)
    """

    calls: Mapping[str, Callable[[Mapping[str, Any]], dict[str, Any]]] = {}
    """More calls that a server of vlagents answers with it, by name: functions of plain values and arrays."""

    @abstractmethod
    def metadata(self) -> Metadata:
        """Return what the policy needs and gives."""

    @abstractmethod
    def infer(self, observation: Observation) -> Chunk:
        """Return the actions from the time of an observation on.

        Args:
            observation: One moment of one session.

        Raises:
            InvalidInput: Something that the policy needs is missing or wrong.
        """

    def infer_batch(self, observations: Sequence[Observation]) -> Sequence[Chunk]:
        """Return the actions for several observations, each of another session.

        A server calls this method of a policy that overrides it, with the observations of all waiting robots. If it
        raises an error, they are passed one by one, so that a mistake of one robot does not affect another.
        """
        return [self.infer(observation) for observation in observations]

    def reset(  # noqa: B027  a policy may remember nothing
        self, session: str = "", instruction: str = "", *, seed: int | None = None
    ) -> None:
        """Begin an episode: forget the session's memory, and keep its instruction.

        Args:
            session: Name of the robot or copy; others do not change.
            instruction: The task in words.
            seed: Seed of the policy's random numbers; None for any.
        """

    def forget(self, session: str) -> None:  # noqa: B027  a policy may remember nothing
        """Forget a session that has ended; an unknown one is ignored."""

    def close(self) -> None:  # noqa: B027  a policy may hold nothing
        """Release everything. A second call does nothing."""

    def __enter__(self) -> Policy:
        """Return the policy, which is closed at the end of the block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()
