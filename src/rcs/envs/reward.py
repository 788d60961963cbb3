"""The reward of a step: what a setup chooses to pay for the states that a task judges, and for success."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # setups name the kinds, and are made without the simulator
    from rcs.envs.layers import CopyIndex
    from rcs.envs.task import Judgement
    from rcs.sim.robot import SimRobot
    from rcs.sim.world import World

RewardKind = Literal["shaped", "dense", "sparse"]
"""Rule of the reward; see `Rewards`."""

PROGRESS_SHARE, STILL_SHARE = 0.6, 0.2
"""Dense reward for the whole progress, and for an arm at rest with the object in place. ManiSkill 3's
PickCube-v1 has three terms for what is progress here, one for rest, and 5 at success; it is divided by 5."""
STILLNESS = 5.0
"""How fast the pay for an arm at rest falls with the norm of its joint velocities [s/rad] (PickCube-v1)."""


class Rewards:
    """Pays for each step, in each copy, by one of three rules; the discount is the learner's.

    - `shaped` pays 1 at success, and in every step `discount · Φ(s') - Φ(s)`, where the potential Φ is the progress.
      That changes no optimal policy (Ng, Harada and Russell 1999, "Policy invariance under reward transformations").
      In an episode that the task terminates, Φ of the last state is 0. In one that is truncated it is the progress,
      because there the learner goes on with its estimate. So what shaping pays in T steps is, discounted,
      `discount^T · Φ_T - Φ_0`, and to stay where one is costs something, however near the goal.
    - `dense` pays for where the state is, 0 … 0.8 per step: the terms of ManiSkill 3's PickCube-v1, divided by 5.
      Success ends the episode here, and pays what 1 per step would be worth for ever: `1 / (1 - discount)`.
    - `sparse` pays 1 at success.

    A copy whose simulation diverges keeps its potential, for the state is lost, and is paid nothing else.
    """

    memory: ClassVar[tuple[str, ...]] = ("_potential",)

    def __init__(
        self, world: World, robots: Sequence[SimRobot], kind: RewardKind = "shaped", discount: float = 0.99
    ) -> None:
        """Set the rule.

        Args:
            world: The world.
            robots: Its robots, whose arms the dense reward wants at rest in the end.
            kind: The rule.
            discount: Worth of a reward one step later, above 0; at most 1, and less for the dense reward.
        """
        self._robots = robots
        self._kind = kind
        self._discount = discount
        self._none = np.zeros(world.leading)
        self._potential: NDArray[np.float64] = self._none
        """Potential of the last state, (*leading,)."""

    def begin(self, start: Judgement, where: CopyIndex) -> None:
        """Remember the potential of the starts of some copies' episodes.

        Args:
            start: The judgement of the present state of all copies.
            where: The copies; `...` for all, or for the only one.
        """
        potential = np.array(self._potential)  # of one copy it is a number of NumPy's
        potential[where] = (self._none + self._progress(start))[where]
        self._potential = potential

    def pay(
        self,
        judgement: Judgement,
        *,
        terminated: Any,
        failed: Any = np.False_,
        diverged: NDArray[np.bool_] | None = None,
        starting: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float64]:
        """Return the reward of the step that led to the present state, (*leading,). Call it once per step.

        Args:
            judgement: The task's.
            terminated: Which episodes the step terminates.
            failed: Which episodes a fault or divergence truncates; a success in the same step does not count.
            diverged: In which of these the simulation diverged; None for none.
            starting: Copies whose episode starts in the place of a step, which pays nothing; None for none.
        """
        success = np.False_ if judgement.success is None else judgement.success & ~failed
        progress = self._progress(judgement)
        if diverged is not None:
            progress = np.where(diverged, self._potential, progress)
        potential = _where(terminated, 0.0, progress)
        if judgement.reward is not None:
            reward = self._none + judgement.reward
        elif self._kind == "shaped":
            reward = self._discount * potential - self._potential + success
        elif self._kind == "dense":
            worth = _where(terminated, 1.0 / (1.0 - self._discount), 1.0)
            reward = _where(success, worth, self._of_state(progress, judgement.is_placed))
        else:
            reward = self._none + success
        if diverged is not None and (judgement.reward is not None or self._kind != "shaped"):
            reward = np.where(diverged, 0.0, reward)
        if starting is not None:
            reward, potential = np.where(starting, 0.0, reward), np.where(starting, progress, potential)
        self._potential = potential
        return reward

    def _progress(self, judgement: Judgement) -> NDArray[np.float64]:
        return self._none if judgement.progress is None else judgement.progress

    def _of_state(self, progress: NDArray[np.float64], is_placed: NDArray[np.bool_] | None) -> NDArray[np.float64]:
        """Return what the dense reward pays for a state that is no success, 0 … 0.8, (*leading,)."""
        paid = PROGRESS_SHARE * progress
        if is_placed is None or not is_placed.any():
            return paid
        velocities = np.concatenate([robot.joint_velocities for robot in self._robots], axis=-1)
        # NumPy's own sums add in an order that may depend on how many copies there are.
        speed = np.sqrt(np.add.accumulate(velocities * velocities, axis=-1)[..., -1])
        return paid + STILL_SHARE * is_placed * (1.0 - np.tanh(STILLNESS * speed))


def _where(condition: Any, chosen: Any, other: Any) -> Any:
    """Return `np.where`, several times as fast for a number."""
    if isinstance(condition, np.ndarray):
        return np.where(condition, chosen, other)
    return np.float64(chosen if condition else other)
