"""Shows transitions to the observers of an environment, each of one copy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.observer import Observer, Transition
from rcs.envs.spaces import Observation
from rcs.envs.step.chain import merged
from rcs.envs.step.clock import Clock
from rcs.envs.step.judge import Step, row
from rcs.envs.step.simulation import Simulation
from rcs.envs.step.stack import Stack, for_all


class Observers:
    """Observers, each of one copy. Transitions are put together only while there are observers."""

    def __init__(self, stack: Stack, clock: Clock, simulation: Simulation | None) -> None:
        """Start without observers."""
        self._stack = stack
        self._clock = clock
        self._simulation = simulation
        self._is_batch = simulation is not None and bool(simulation.world.leading)
        self._observers: list[tuple[int, Observer]] = []
        self._notes: dict[str, Any] = {}
        self._last: dict[int, dict[str, Any]] = {}
        """Fields of transitions from simulation and sensors, at the moments that were shown last, by copy."""
        self.command_time: float | None = None
        """Time at which the targets of the present step were sent [s]."""
        self.after_hold = False
        """Whether the devices have been made to hold since the last step."""

    def add(self, observer: Observer, copy: int = 0) -> None:
        """Show an observer every step of a copy from its next episode on."""
        self._observers.append((copy, observer))

    def remove(self, observer: Observer) -> None:
        """Show an observer no more steps."""
        self._observers = [(copy, one) for copy, one in self._observers if one is not observer]
        watched = {copy for copy, _ in self._observers}
        self._last = {copy: moment for copy, moment in self._last.items() if copy in watched}

    def note(self, notes: Mapping[str, Any]) -> None:
        """Add notes to the next step for observers."""
        self._notes.update(notes)

    def on_reset(self, observation: Observation, info: dict[str, Any], seeds: Mapping[int, int | None]) -> None:
        """Show the first observation of episodes.

        Args:
            observation: The observation of all copies.
            info: The info of all copies.
            seeds: The seeds of the copies that start.
        """
        for copy, observer in self._observers:
            if copy in seeds:
                observer.on_reset(self._transition(copy, observation, info), seeds[copy])
        self._notes = {}

    def on_step(
        self, step: Step, action: Any, starting: NDArray[np.bool_] | None, diverged: NDArray[np.bool_] | None = None
    ) -> None:
        """Show a step of all copies except those that start their next episode instead.

        Args:
            step: The step.
            action: Its action.
            starting: Copies that start; None for none.
            diverged: Copies that show the moment before, since the one after the step is lost; None for none.
        """
        lost = () if diverged is None else np.flatnonzero(diverged)
        if self._is_batch and self._observers:
            action = _arrays(action)
        for copy, observer in self._observers:
            is_lost = copy in lost
            if (starting is None or not starting[copy]) and (copy in self._last or not is_lost):
                observer.on_step(self._transition(copy, step.observation, step.info, step, action, is_lost=is_lost))
        self._notes = {}

    def on_end(self, end: str, reasons: Mapping[str, str], *, copy: int | None = None) -> None:
        """End the episodes that observers see, or that of one copy, because they were broken off."""
        self._notes = {}  # those of a step that is lost
        ended = [observer for own, observer in self._observers if copy in (None, own)]
        self._last = {} if copy is None else {own: moment for own, moment in self._last.items() if own != copy}
        for_all([lambda observer=observer: observer.on_end(end, reasons) for observer in ended])

    def info(self) -> dict[str, Any]:
        """Return the info that observers of a single environment add."""
        info: dict[str, Any] = {}
        for _, observer in self._observers:
            if type(observer).info is not Observer.info:
                info = merged(info, observer.info())  # several may have parts of one key, such as their errors
        return info

    def closes(self) -> list[Callable[[], None]]:
        """Return the calls that close the observers."""
        return [observer.close for _, observer in self._observers]

    def _transition(
        self,
        copy: int,
        observation: Observation,
        info: dict[str, Any],
        step: Step | None = None,
        action: Any = None,
        *,
        is_lost: bool = False,
    ) -> Transition:
        executed = None if step is None else self._stack.executed
        reward, terminated, truncated = (0.0, False, False) if step is None else _ends(step, copy, self._is_batch)
        if self._is_batch:
            observation, info = row(observation, copy), row(info, copy)
            action = None if action is None else row(action, copy)
            executed = None if executed is None else row(executed, copy)
        moment = self._last[copy] = self._last[copy] if is_lost else self._moment(copy)
        return Transition(
            observation=observation,
            action=action,
            executed=executed,
            reward=reward,
            terminated=terminated,
            truncated=truncated,
            info=info,
            time=self._clock.now(),
            command_time=None if step is None else self.command_time,
            after_hold=step is not None and self.after_hold,
            notes=self._notes,
            **moment,
        )

    def _moment(self, copy: int) -> dict[str, Any]:
        """Return the fields of a transition that are read from simulation and sensors."""
        simulation, times = self._simulation, self._stack.capture_times()
        objects = {} if simulation is None else simulation.object_poses()
        return {
            "capture_times": row(times, copy) if self._is_batch else times,
            "device_times": {} if self._is_batch else self._stack.device_times(),
            "sim_state": None if simulation is None else simulation.world.core.get_state(copy),
            "objects": row(objects, copy) if self._is_batch else objects,
        }


def _arrays(action: Mapping[str, Any]) -> dict[str, Any]:
    """Return an action in arrays, whose rows are those of copies; it may have come in lists or tensors."""
    return {key: _arrays(value) if isinstance(value, Mapping) else np.asarray(value) for key, value in action.items()}


def _ends(step: Step, copy: int, is_batch: bool) -> tuple[float, bool, bool]:
    values = step.reward, step.terminated, step.truncated
    reward, terminated, truncated = (np.asarray(one)[copy] if is_batch else one for one in values)
    return float(reward), bool(terminated), bool(truncated)
