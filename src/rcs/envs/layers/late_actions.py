"""Actions that miss their step now and then, as in a control loop whose policy or network is late."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.layers.layer import CopyIndex, Layer, everywhere, renew
from rcs.envs.spaces import GRIPPER, HAND, JOINTS, Action, Observation
from rcs.sim.splitmix import numbered

if TYPE_CHECKING:
    from rcs.envs.episode_random import EpisodeRandom
    from rcs.sim.world import Copies


class LateActions(Layer):
    """Send the last action once more in some steps, drawn at random; the action itself comes with the next step.

    Layers above do not notice, because their action is on its way. `info["is_late"]` reports it, and a recording has
    the sent action as the executed one. It is the lowest layer of a simulated robot.
    """

    memory = ("_keys", "_steps", "_is_late", "_last")

    def __init__(self, share: float, leading: tuple[int, ...] = ()) -> None:
        """Be never late before the first `begin`.

        Args:
            share: Share of the steps whose action is late, 0 … 1.
            leading: Leading shape of all arrays, () or (copies,).
        """
        self.share = share
        self._keys: NDArray[np.uint64] = np.zeros(leading, np.uint64)
        self._steps: NDArray[np.int64] = np.zeros(leading, np.int64)
        self._is_late: NDArray[np.bool_] = np.zeros(leading, np.bool_)
        self._last: Action = {}
        self._mapped: tuple[Action, Action, NDArray[np.bool_]] | None = None
        """Requested and sent action of the last `map_action`, and the copies that are late."""

    def begin(self, random: EpisodeRandom, copies: Copies = None) -> None:
        """Take the random numbers of some copies' next episodes.

        Args:
            random: Random numbers for exactly these copies; they are not advanced.
            copies: Which copies; None for all.
        """
        keys = np.array(self._keys)
        keys[... if copies is None else copies] = random.branch("late_actions").bits()
        self._keys = keys

    def reset(self, observation: Observation, where: CopyIndex = everywhere) -> None:
        """Count steps from 0; the robot stays before the first action."""
        self._last = {key: renew(self._last.get(key), value, where) for key, value in _commandable(observation).items()}
        self._steps = renew(self._steps, np.zeros_like(self._steps), where)
        self._is_late = renew(self._is_late, np.zeros_like(self._is_late), where)

    def rebase(self, observation: Observation) -> None:
        """Take the measured state for what was sent last, but the last target of a gripper, so that nothing falls."""
        last = _commandable(observation)
        if GRIPPER in last and GRIPPER in self._last:
            last[GRIPPER] = self._last[GRIPPER]
        self._last = {key: value.copy() for key, value in last.items()}

    def map_action(self, action: Action) -> Action:
        """Return the last action in place of a late one."""
        is_late = numbered(self._keys, self._steps + 1) < self.share
        sent = action
        if is_late.any():
            sent = {
                key: np.where(is_late[..., None], self._last[key], value).astype(value.dtype)
                for key, value in action.items()
            }
        self._mapped = action, sent, is_late
        return sent

    def map_executed(self, executed: Action) -> Action:
        """Return the requested action, but for copies that were sent another one than this layer chose."""
        if self._mapped is None:
            raise RuntimeError("LateActions.map_executed was called before map_action")
        asked, sent, is_late = self._mapped
        if all(executed[key] is value for key, value in sent.items()):
            self._last, self._is_late = asked, is_late
            above = asked
        else:
            is_as_wanted = np.logical_and.reduce([(executed[key] == value).all(-1) for key, value in sent.items()])
            wanted = is_as_wanted[..., None]
            above = {key: np.where(wanted, asked[key], value) for key, value in executed.items()}
            last = dict(above)
            if GRIPPER in above:  # one that is held goes on to its last target, and so does the next late action
                is_sent = wanted | (executed[GRIPPER] == sent[GRIPPER])
                last[GRIPPER] = np.where(is_sent, above[GRIPPER], self._last[GRIPPER])
            self._last = last
            self._is_late = is_late & is_as_wanted
        self._steps = self._steps + 1
        return above

    def info(self) -> dict[str, NDArray[Any]]:
        """Return whether the last action was late."""
        return {"is_late": self._is_late}

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return f"LateActions({self.share:.0%} of the steps)"


def _commandable(observation: Observation) -> Action:
    """Return what an action of the lowest level has, too."""
    return {key: observation[key] for key in (JOINTS, GRIPPER, HAND) if key in observation}
