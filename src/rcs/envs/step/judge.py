"""The judgement of a step: reward, ends and info, from the state after it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs._core import StepEnd
from rcs.envs.spaces import Observation
from rcs.envs.step.clock import Clock
from rcs.envs.step.simulation import Simulation
from rcs.envs.step.stack import Stack, copied

DIVERGED, FAULT = "diverged", "fault"
"""Values of `info["end"]` after a simulation left the range of finite numbers, and after a device failed or a simulated
arm collided."""

_FAILED, _FAULT = StepEnd.failed.value, StepEnd.fault.value
_ENDS = {end.value: end.name for end in StepEnd} | {_FAILED: DIVERGED}
_END_NAMES = np.array([_ENDS.get(i, "") for i in range(1 + max(_ENDS))])
"""Values of `info["end"]`, by the value of `StepEnd`."""

_ARRAYS = np.ndarray, np.generic


@dataclass(kw_only=True, slots=True)
class Step:
    """The result of a step. Arrays have the leading shape, () or (copies,)."""

    observation: Observation
    reward: Any
    """(*leading,) float64."""
    terminated: Any
    """(*leading,) bool."""
    truncated: Any
    """(*leading,) bool."""
    info: dict[str, Any]


class Judge:
    """Counts steps and judges each.

    A single environment has NumPy's numbers where a batch has arrays, because they are faster.
    """

    def __init__(
        self, stack: Stack, clock: Clock, simulation: Simulation | None, max_episode_steps: int | None
    ) -> None:
        """Judge steps of these parts.

        Args:
            stack: Ports and layers, which add to `info`.
            clock: Knows why steps ended and what time it is.
            simulation: The simulated world with its task; None for real devices alone.
            max_episode_steps: An episode is truncated after this many steps; None for no limit.
        """
        self._stack = stack
        self._clock = clock
        self._simulation = simulation
        self._max_episode_steps = max_episode_steps
        self._leading: tuple[int, ...] = () if simulation is None else simulation.world.leading
        self._ends: NDArray[np.uint8] = clock.ends.reshape(self._leading)
        self._last_time: Any = None
        self._last_ages: Mapping[str, Any] = {}
        self.steps: NDArray[np.int64] = np.zeros(self._leading, np.int64)
        """Steps of the present episodes, (*leading,)."""

    def failed(self, starting: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
        """Return the copies whose last step diverged or ended in a collision, (*leading,); None for none.

        Args:
            starting: Copies that start their next episode in place of a step; None for none.
        """
        if (self._ends.max() if self._leading else self._ends.item()) < _FAILED:
            return None
        failed = self._ends >= _FAILED
        failed = failed if starting is None else failed & ~starting
        return failed if failed.any() else None

    def diverged(self, failed: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
        """Return the copies whose simulation diverged, of those that `failed` has returned; None for none."""
        diverged = None if failed is None else failed & (self._ends == _FAILED)
        return None if diverged is None or not diverged.any() else diverged

    def without_diverged(self, new: Observation, last: Observation, diverged: NDArray[np.bool_]) -> Observation:
        """Return an observation in which diverged copies have their last observation."""
        return _with_rows(new, last, diverged if self._leading else ...)

    def note(self) -> None:
        """Note the time and the ages of the present observation: copies that diverge in the next step keep them."""
        if self._simulation is not None:
            self._last_time, self._last_ages = self.time(), self._stack.ages()

    def collisions(self, failed: NDArray[np.bool_]) -> dict[str, Any]:
        """Return the reasons for which copies of the simulation failed, as in `Simulation.faults`."""
        return {} if self._simulation is None else self._simulation.faults(failed & (self._ends != _FAILED))

    def judge(
        self,
        observation: Observation,
        starting: NDArray[np.bool_] | None,
        failed: NDArray[np.bool_] | None,
        faults: Mapping[str, str],
    ) -> Step:
        """Judge the present state.

        Args:
            observation: The observation of the highest level.
            starting: Copies that start their next episode in place of a step; None for none.
            failed: Copies whose simulation failed, as `failed` returns them.
            faults: Reasons of the devices that are in their fault state, by name.
        """
        self.steps = self.steps + (1 if starting is None else ~starting)
        reward: Any = 0.0
        never: Any = np.zeros(self._leading, np.bool_) if self._leading else np.False_
        terminated, truncated = never, never if failed is None else failed
        info: dict[str, Any] = {}
        time, ages = self.time(), {} if self._clock.is_real else self._stack.ages()
        if self._simulation is not None:
            judged = self._simulation.judged
            judgement = self._simulation.evaluate()
            info = judgement.info
            if judgement.terminated is not None:
                terminated = judgement.terminated if starting is None else judgement.terminated & ~starting
            lost = np.True_ if faults else np.False_ if failed is None else failed
            if failed is not None or faults:
                terminated = terminated & ~lost
            if (diverged := self.diverged(failed)) is not None:  # MuJoCo has reset them
                new = {"info": info, "time": time, "ages": ages}
                last = {"info": judged, "time": self._last_time, "ages": self._last_ages}
                info, time, ages = _with_last(new, last, diverged if self._leading else None).values()
            self._last_time, self._last_ages = time, ages
            rewards = self._simulation.rewards
            reward = rewards.pay(judgement, terminated=terminated, failed=lost, diverged=diverged, starting=starting)
            self._simulation.require_reward(reward, judgement)
        elif (outcome := self._clock.outcome()) is not None:
            reward, terminated, truncated, info = outcome
            terminated, truncated = np.bool_(terminated), np.bool_(truncated)
        if self._max_episode_steps is not None:
            is_last = (self.steps >= self._max_episode_steps) & ~terminated
            truncated = truncated | (is_last if starting is None else is_last & ~starting)
        if self._leading:
            info = {**info, **self._stack.info(), "time": time, "end": _END_NAMES[self._ends]}
        else:
            info = row({**info, **self._stack.info()}, ...)
            info["time"], info["end"] = time.item(), _ENDS.get(self._ends.item(), "")
        if ages:
            info["ages"] = ages if self._leading else row(ages, ...)
        info["target"] = copied(self._stack.target)
        if self._clock.is_real:
            info.update(self.timing())
        if faults:
            info.update(end=FAULT, faults=faults)
            terminated, truncated = np.False_, np.True_
        return Step(observation=observation, reward=reward, terminated=terminated, truncated=truncated, info=info)

    def timing(self) -> dict[str, Any]:
        """Return how late a step in real time ended, ages of measurements [s], and clamps and reconnections so far."""
        now = self._clock.now()
        ages = {name: now - captured for name, captured in self._stack.capture_times().items()}
        counts = {"clamped": self._stack.clamped(), "reconnections": self._stack.reconnections()}
        return {"late": self._clock.late, "ages": ages, **{name: count for name, count in counts.items() if count}}

    def time(self) -> Any:
        """Return the time of the present observation [s]: that of the simulation, or the host's monotonic clock."""
        if self._simulation is None:
            return np.float64(self._clock.now())
        return self._simulation.world.time.copy()

    def collided(self, step: Step) -> NDArray[np.intp]:
        """Return the copies of a batch whose episode a collision ended in a step."""
        return np.flatnonzero(step.truncated & (self._ends == _FAULT))


def row(values: Mapping[str, Any], where: Any) -> dict[str, Any]:
    """Return the values of one copy: numbers and booleans as Python's own, arrays as views of theirs."""
    own_values: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, _ARRAYS):
            own: Any = value if where is ... else value[where]  # pyright: ignore[reportIndexIssue]  batches have arrays
            own_values[key] = own if getattr(own, "ndim", 1) else own.item()
        elif isinstance(value, dict):  # not `Mapping`: an abstract class takes ten times as long to ask for
            own_values[key] = row(value, where)
        else:
            own_values[key] = value
    return own_values


def _with_rows(new: Mapping[str, Any], old: Mapping[str, Any], where: Any) -> dict[str, Any]:
    """Return new values with some rows of the old ones, in any nesting."""
    merged = copied(new)
    for key, value in merged.items():
        if isinstance(value, dict):
            merged[key] = _with_rows(value, old[key], where)
        else:
            value[where] = old[key][where]
    return merged


def _with_last(new: Any, last: Any, where: NDArray[np.bool_] | None) -> Any:
    """Return new info with some rows of the last one, or with all of it for None; what was not in that stays new."""
    if isinstance(new, dict):
        return {key: _with_last(value, last[key], where) if key in last else value for key, value in new.items()}
    if where is None:
        return last.copy() if isinstance(last, _ARRAYS) else last
    return np.where(where.reshape(-1, *[1] * (new.ndim - 1)), last, new) if isinstance(new, np.ndarray) else new
