"""Runs an observer beside the loop of an environment, in a thread of its own.

The loop puts each transition into a bounded queue and goes on. When the thread falls behind by the bound, new steps are
left out and counted; starts and ends of episodes are never left out. Transitions are handed over as they are, because
their arrays are written once, but for the action, which is the caller's, and pixels, whose memory may be used again.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rcs_data.options import require_whole

from rcs.background_thread import BackgroundThread
from rcs.envs.observer import Observer, Transition
from rcs.envs.observers.recorder import Recorder
from rcs.envs.spaces import PIXELS
from rcs.errors import InvalidSetup, WrongOrder

_log = logging.getLogger(__name__)

BOUND = 128
"""Largest number of steps that wait: about four seconds at 30 Hz."""

PATIENCE = 5.0
"""Longest time that `close` waits for the steps in the queue [s]."""


class InBackground(Observer):
    """Shows everything to an observer from a thread, so that a slow observer never slows the loop.

    An error of the observer ends its work and nothing else: it is logged at once, `info["observers"]` has its words in
    every later step, and `close` raises it.

    Examples:
        >>> import rcs
        >>> from rcs.envs import InBackground, Observer
        >>> class Printer(Observer):
        ...     def on_reset(self, first, seed):
        ...         print("start")
        ...
        ...     def on_step(self, transition):
        ...         print(transition.reward)
        >>> env = rcs.make("Free", observers=[InBackground(Printer())])
    """

    def __init__(self, observer: Observer, *, bound: int = BOUND) -> None:
        """Take over an observer; its thread starts with the first episode.

        Args:
            observer: Called from the thread alone from now on, but for its `info`, which must answer at once.
            bound: How many steps may wait.

        Raises:
            InvalidSetup: The bound is not a whole number from 1, or the observer is a `Recorder`.
        """
        require_whole("bound", bound, 1)
        if isinstance(observer, Recorder):
            raise InvalidSetup("A Recorder has a thread of its own; use Recorder(writer, background=True).")
        self.observer = observer
        self.missed = 0
        """Steps that were left out because the observer was too slow."""
        self._bound = bound
        self._name = type(observer).__name__
        self._thread = BackgroundThread[_Call](f"rcs observer {self._name}", lambda call: call.make())
        self._is_closed = False
        self._steps = 0

    @property
    def error(self) -> Exception | None:
        """The exception that the observer raised."""
        return self._thread.error

    def on_reset(self, first: Transition, seed: int | None) -> None:
        """Queue the start of an episode."""
        first = _own(first)
        self._put(lambda: self.observer.on_reset(first, seed), is_step=False)

    def on_step(self, transition: Transition) -> None:
        """Queue a step, or count it as missed."""
        transition = _own(transition)
        self._put(lambda: self.observer.on_step(transition), is_step=True)

    def on_end(self, end: str, reasons: Mapping[str, str]) -> None:
        """Queue the abort of an episode."""
        reasons = dict(reasons)
        self._put(lambda: self.observer.on_end(end, reasons), is_step=False)

    def info(self) -> Mapping[str, Any]:
        """Return the info of the observer, and its error."""
        if self.error is not None:
            return {**self.observer.info(), "observers": {self._name: f"{type(self.error).__name__}: {self.error}"}}
        return self.observer.info()

    def wait(self, timeout: float = PATIENCE) -> bool:
        """Wait until the observer has seen everything.

        Args:
            timeout: Longest time to wait [s].

        Returns:
            Whether it has.
        """
        return self._thread.wait(timeout)

    def close(self) -> None:
        """Let the observer see the steps that wait, end the thread and close the observer. Closing twice is harmless.

        Raises:
            Exception: The error of the observer, once.
        """
        if self._is_closed:
            return
        if self._thread.is_current:
            raise WrongOrder("An observer cannot close the thread that it runs in; close the environment instead.")
        self.wait()
        self._is_closed = True
        if not self._thread.close(PATIENCE):
            _log.error("The observer %s is still busy after %g s; its thread is left behind.", self._name, PATIENCE)
        if self.missed:
            _log.warning("%s was too slow and missed %d of %d steps.", self._name, self.missed, self._steps)
        self.observer.close()
        if self.error is not None:
            raise self.error

    def _put(self, call: Callable[[], None], *, is_step: bool) -> None:
        if self.error is not None or self._is_closed:
            return
        with self._thread.changed:
            waiting = self._thread.waiting
            self._steps += is_step
            if len(waiting) >= self._bound:
                if is_step:
                    self.missed += 1
                    return
                if (step := next((one for one in waiting if one.is_step), None)) is not None:
                    waiting.remove(step)
                    self.missed += 1
            self._thread.put(_Call(call, is_step))


@dataclass(frozen=True, eq=False)
class _Call:
    make: Callable[[], None]
    is_step: bool


def _own(transition: Transition) -> Transition:
    """Return a transition whose dictionaries, action and pixels are its own; other arrays are shared."""
    action = None if transition.action is None else _copied(transition.action)
    observation = _copied(transition.observation, only=PIXELS)
    return replace(transition, observation=observation, action=action, info=dict(transition.info))


def _copied(values: Mapping[str, Any], *, only: str = "") -> dict[str, Any]:
    """Return values in dictionaries of their own, in any nesting, with copies of all arrays, or of those of one key."""
    copied: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            copied[key] = _copied(value, only=only)
        else:
            copied[key] = np.array(value) if only in ("", key) else value
    return copied
