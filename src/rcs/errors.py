"""Named errors for all that can go wrong: every error says what was given, what is valid and what to do."""

from __future__ import annotations

from rcs_data.errors import CorruptEpisode as CorruptEpisode
from rcs_data.errors import DatasetError as DatasetError
from rcs_data.errors import InvalidSetup as InvalidSetup
from rcs_data.errors import MissingDependency as MissingDependency
from rcs_data.errors import RcsError as RcsError
from rcs_data.errors import UnknownName as UnknownName
from rcs_data.errors import WrongOrder as WrongOrder
from rcs_data.errors import require_fields as require_fields


class InvalidAction(RcsError, ValueError):
    """An action has a wrong key, shape, dtype or value; nothing was sent to a device."""


class Refused(RcsError, RuntimeError):
    """A gate lets an action through to no device; all devices hold."""

    ends_episode: bool = False
    """Whether the episode ends with it, as truncated."""


class PlanningFailed(RcsError, RuntimeError):
    """There is no path: start or goal collide, the goal is out of reach, or the time is up."""

    def __init__(self, message: str, reason: str = "") -> None:
        """Keep the reason.

        Args:
            message: Words on what is wrong and what to do.
            reason: `start`, `goal`, `unreachable` or `time`.
        """
        super().__init__(message)
        self.reason = reason


class DeviceFault(RcsError, RuntimeError):
    """A device is in a fault state; `recover()` clears it."""


class CorruptCheckpoint(RcsError, ValueError):
    """A checkpoint of a training is incomplete, or its bytes are not what was written."""


class SimulationError(RcsError, RuntimeError):
    """MuJoCo failed, or left out contacts, in its own words; or a simulator of another project did, or was late."""
