"""Runs an observer beside the loop of an environment, in a thread of its own.

Time: the loop puts each transition into a bounded queue and goes on. When the thread falls behind by the bound, new
steps are left out and counted; starts and ends of episodes are never left out. Transitions are handed over as they are:
their arrays are written once.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from rcs.envs.observer import Observer, Transition
from rcs.errors import InvalidSetup, WrongOrder

_log = logging.getLogger(__name__)

BOUND = 128
"""Steps that may wait: about four seconds at 30 Hz."""

PATIENCE = 5.0
"""How long `close` waits for what is still in the queue [s]."""


class InBackground(Observer):
    """Shows everything to an observer from a thread, so that a slow observer never slows the loop.

    An error of the observer ends its work and nothing else: it is logged at once, `info["observers"]` has its words in
    every later step, and `close` raises it.

    Example:
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
            InvalidSetup: The bound is not a whole number from 1.
        """
        if isinstance(bound, bool) or not isinstance(bound, int) or bound < 1:
            raise InvalidSetup(f"bound is {bound!r}; valid is a whole number of steps from 1.")
        self.observer = observer
        self.missed = 0
        """Steps that were left out because the observer was too slow."""
        self.error: Exception | None = None
        """What the observer raised."""
        self._bound = bound
        self._waiting: deque[tuple[bool, Callable[[], None]]] = deque()
        self._changed = threading.Condition()
        self._is_busy = False
        self._is_closing = False
        self._steps = 0
        self._thread: threading.Thread | None = None

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
        """Return what the observer has to say, its error, and how many steps it has missed."""
        if self.error is not None:
            name = type(self.observer).__name__
            return {**self.observer.info(), "observers": {name: f"{type(self.error).__name__}: {self.error}"}}
        return self.observer.info()

    def wait(self, timeout: float = PATIENCE) -> bool:
        """Wait until the observer has seen everything.

        Args:
            timeout: Longest time to wait [s].

        Returns:
            Whether it has.
        """
        end = time.monotonic() + timeout
        with self._changed:
            while self._waiting or self._is_busy:
                rest = end - time.monotonic()
                if rest <= 0 or self._thread is None or not self._thread.is_alive():
                    return False
                self._changed.wait(rest)
        return True

    def close(self) -> None:
        """Let the observer see what waits, end the thread and close the observer. Closing twice is harmless.

        Raises:
            Exception: What the observer has raised, once.
        """
        if self._is_closing:
            return
        if threading.current_thread() is self._thread:
            raise WrongOrder("An observer cannot close the thread that it runs in; close the environment instead.")
        self.wait()
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(PATIENCE)
            if thread.is_alive():
                _log.error("%s is still busy after %g s; its thread is left behind.", self._name, PATIENCE)
        if self.missed:
            _log.warning("%s was too slow and missed %d of %d steps.", self._name, self.missed, self._steps)
        self.observer.close()
        if self.error is not None:
            raise self.error

    @property
    def _name(self) -> str:
        return f"The observer {type(self.observer).__name__}"

    def _put(self, call: Callable[[], None], *, is_step: bool) -> None:
        if self.error is not None or self._is_closing:
            return
        with self._changed:
            self._steps += is_step
            if len(self._waiting) >= self._bound:
                self.missed += 1
                if is_step:
                    return
                self._drop_a_step()
            self._waiting.append((is_step, call))
            self._changed.notify_all()
        if self._thread is None:
            name = f"rcs observer {type(self.observer).__name__}"
            self._thread = threading.Thread(target=self._work, name=name, daemon=True)
            self._thread.start()

    def _drop_a_step(self) -> None:
        for index, (is_step, _) in enumerate(self._waiting):
            if is_step:
                del self._waiting[index]
                return
        self.missed -= 1  # nothing but starts and ends: nothing is dropped

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and not self._is_closing:
                    self._changed.wait()
                if not self._waiting or self._is_closing:
                    return
                _, call = self._waiting.popleft()
                self._is_busy = True
            try:
                call()
            except Exception as err:  # noqa: BLE001  a thread has no caller; `info` tells it and `close` raises it
                _log.exception("%s failed and sees no more steps.", self._name)
                self.error = err
            with self._changed:
                self._is_busy = False
                if self.error is not None:
                    self._waiting.clear()
                self._changed.notify_all()
            if self.error is not None:
                return


def _own(transition: Transition) -> Transition:
    """Return a transition whose dictionaries nobody else changes; arrays are written once and shared."""
    return replace(transition, observation=dict(transition.observation), info=dict(transition.info))
