"""Errors that are raised on purpose. An error on the other side of a wire has the same class on this side."""

from __future__ import annotations

import sys
from collections.abc import Sequence


class VlagentsError(Exception):
    """Anything that is raised on purpose."""

    kind = "error"
    """Name of the error on the wire."""


class InvalidInput(VlagentsError, ValueError):
    """An observation, a session or an option is not what the policy takes; the message says what is valid."""

    kind = "invalid"


class Mismatch(VlagentsError):
    """The policy needs something that the robot does not offer."""

    def __init__(self, differences: Sequence[str]) -> None:
        """Say all differences, a line each."""
        self.differences = tuple(differences)
        super().__init__("The policy and the robot do not fit:\n" + "\n".join(f"- {line}" for line in self.differences))


class BadMessage(VlagentsError):
    """The other side sent bytes that are no message, or too many. The connection is closed."""

    kind = "bad message"


class ConnectionLost(VlagentsError, ConnectionError):
    """The other side cannot be reached, or has gone."""

    kind = "lost"


class DeadlineExceeded(VlagentsError, TimeoutError):
    """The other side did not answer, read or write in time."""

    kind = "late"


class Unauthorized(VlagentsError):
    """The token is missing or wrong."""

    kind = "unauthorized"


class PolicyFailed(VlagentsError):
    """The policy raised an error in a call; the message has its text."""

    kind = "failed"


class AddressTaken(VlagentsError, OSError):
    """The address of a server is in use."""

    def __init__(self, address: object) -> None:
        """Name the address, and what to do."""
        super().__init__(
            f"Something listens at {address} already. Choose another port (`--port`), or end what listens there."
        )


class SimulatorTaken(InvalidInput):
    """Another client has opened the simulator since; it serves whoever opened it last."""

    kind = "taken"


class MissingStack(VlagentsError, ImportError):
    """A package that a policy needs is not installed in this environment."""

    def __init__(self, policy: str, package: str) -> None:
        """Name the package, and the recipe of an environment that has it."""
        super().__init__(
            f"The policy {policy!r} needs the package {package!r}, which is not installed here. "
            f"`vlagents recipe {policy}` prints how to make an environment for it."
        )


class MissingSimulator(VlagentsError, ImportError):
    """A simulator is not installed in this environment."""

    def __init__(self, simulator: str, package: str) -> None:
        """Name the package, and where it would be found."""
        super().__init__(
            f"The simulator {simulator!r} needs the package {package!r}, which is not installed in {sys.prefix}. "
            "Serve it with the Python of an environment of its own; `make sims` makes them in build/interop."
        )


LONGEST_TEXT = 10_000
"""Most letters of an error on a wire."""


def as_failure(error: BaseException) -> dict[str, str]:
    """Return an error as a wire carries it."""
    is_ours = isinstance(error, VlagentsError)
    text = str(error) if is_ours else f"{type(error).__name__}: {error}"
    shown = text[:LONGEST_TEXT].encode(errors="replace").decode()
    return {"kind": error.kind if is_ours else PolicyFailed.kind, "text": shown}


def from_failure(failure: object) -> VlagentsError:
    """Return the error that a wire carried; one of an unknown kind is a `PolicyFailed`."""
    fields = failure if isinstance(failure, dict) else {}
    kind, text = fields.get("kind"), str(fields.get("text", "no reason was given"))[:LONGEST_TEXT]
    for known in (InvalidInput, SimulatorTaken, BadMessage, ConnectionLost, DeadlineExceeded, Unauthorized):
        if kind == known.kind:
            return known(text)
    return PolicyFailed(text)
