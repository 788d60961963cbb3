"""The interface of a gate: the last look at the targets of all robots before any device sees them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

from rcs.envs.spaces import Action, Observation


class Gate(ABC):
    """Admits, cuts or refuses what all layers of all robots came to.

    When a gate refuses, all devices hold, `info["refused"]` says why, and the episode goes on. A gate that takes longer
    than its deadline refuses too. One that raises anything else breaks the episode off, and all devices hold.
    """

    deadline: float = float("inf")
    """Longest time that `admit` may take [s]; a later answer counts as a refusal."""

    @abstractmethod
    def admit(self, targets: Mapping[str, Action], measured: Mapping[str, Observation]) -> Mapping[str, Action]:
        """Return the targets that the devices may have: those given, or others in their place.

        Args:
            targets: Targets on the lowest level by robot, absolute: `joints` [rad], `gripper`, `hand`. A single robot
                without a name is "".
            measured: What the robots measure at this moment, by the same names.

        Raises:
            Refused: Nothing may move; the message says why.
        """

    def __str__(self) -> str:
        """Return the gate as the printed environment shows it."""
        return type(self).__name__
