"""The interface of a gate: the last look at the targets of all robots before any device sees them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from rcs.envs.layers.layer import CopyIndex
from rcs.envs.spaces import Action, Observation

if TYPE_CHECKING:
    from rcs.envs.parts import Parts
    from rcs.sim.scene import Scene
    from rcs.sim.world import World


class Gate(ABC):
    """Admits, cuts or refuses the targets that all layers of all robots make.

    The actions that a gate returns are checked: every robot and key, shape, finite numbers, bounds. Wrong ones count as
    a refusal. When a gate refuses, all devices hold, `info["refused"]` says why, and the episode goes on, unless the
    refusal ends it (`Refused.ends_episode`). A gate that takes longer than its deadline refuses too. One that raises
    anything else breaks the episode off, and all devices hold.
    """

    deadline: float = float("inf")
    """Longest time that `admit` may take [s]; a later answer counts as a refusal."""
    needs_joints: bool = True
    """Whether it looks at the joints in targets: it is refused where controllers take poses or twists, with `native` in
    the setup."""
    memory: tuple[str, ...] = ()
    """Attributes that decide what follows; see `Layer.memory`."""

    def bind(  # noqa: B027  most gates need no more than targets and measurements
        self, parts: Parts, world: World | None, compose: Callable[[], Scene]
    ) -> None:
        """Look up what the gate needs of the environment, before anything is opened or moves.

        Args:
            parts: The parts of the environment.
            world: The simulated world; None where everything is real.
            compose: Puts the scene together anew: furniture, objects, robots, cameras.
        """

    @abstractmethod
    def admit(self, targets: Mapping[str, Action], measured: Mapping[str, Observation]) -> Mapping[str, Action]:
        """Return the targets that the devices may have: those given, or others in their place.

        Args:
            targets: Targets on the lowest level by robot, absolute: `joints` [rad], `gripper`, `hand`. A single robot
                without a name is "". For a batch, arrays (copies, ...). On its slow way to the start of an episode, and
                always unless `native` is set, an arm has `joints`; else `tquat` or `twist`.
            measured: Present measurements of the robots, by the same names.

        Raises:
            Refused: Nothing may move; the message says why. A batch has no refusals of single copies.
        """

    def sent(self, targets: Mapping[str, Action]) -> None:  # noqa: B027  most gates do not remember
        """See what the devices were sent in the end, after all gates."""

    def reset(self, measured: Mapping[str, Observation], where: CopyIndex) -> None:  # noqa: B027
        """Some copies start anew, where they are measured."""

    def rebase(self, measured: Mapping[str, Observation]) -> None:  # noqa: B027
        """Count from the measured state from now on: after a hold, or a push.

        Args:
            measured: Present measurements of the robots that this is about, by their names; others go on as they are.
        """

    def info(self) -> dict[str, Any]:
        """Return the entries of `info` about the last action."""
        return {}

    def __str__(self) -> str:
        """Return the gate as the printed environment shows it."""
        return type(self).__name__
