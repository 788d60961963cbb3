"""What policies around a policy share: whatever they do not change is that of the one inside."""

from __future__ import annotations

from vlagents.chunk import Chunk
from vlagents.metadata import Metadata
from vlagents.observation import Observation
from vlagents.policy import Policy


class Around(Policy):
    """Passes everything on."""

    def __init__(self, inside: Policy) -> None:
        """Take a policy in; it is closed with this one."""
        self.inside = inside

    def metadata(self) -> Metadata:
        """Return what the policy inside needs and gives."""
        return self.inside.metadata()

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Begin an episode inside."""
        self.inside.reset(session, instruction, seed=seed)

    def infer(self, observation: Observation) -> Chunk:
        """Return what the policy inside answers."""
        return self.inside.infer(observation)

    def forget(self, session: str) -> None:
        """Let the policy inside forget a session."""
        self.inside.forget(session)

    def close(self) -> None:
        """Close the policy inside."""
        self.inside.close()
