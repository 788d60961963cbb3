"""How long it takes from a person's hand to the command, and on to the first picture that has changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.observer import Observer, Transition
from rcs.envs.spaces import FRAMES, RGB

REST = 0.3
"""Time without a new target after which a motion begins anew [s]."""

MOVED = 1e-5
"""Change of a target that counts as a motion [rad, m]."""

CHANGED = 4.0
"""Change of a picture that shows a motion, in parts of the change between two pictures at rest."""

LEAST = 0.05
"""Least change of a picture's mean that shows one [levels of 255]: pictures at rest may be the same to the last bit."""

PIXELS = slice(None, None, 4)
"""Rows and columns of pictures that are compared: whole pictures take the loop milliseconds."""

PATIENCE = 2.0
"""Time after which a picture that has not changed is no longer waited for [s]."""


class Latency(Observer):
    """Measures the latency of each reading (its command), and of each motion that begins from rest (its picture).

    It needs the note `input_time` of an operator. Times are those of one clock, the monotonic one of the host.
    """

    def __init__(self) -> None:
        """Know nothing yet."""
        self.commands: list[float] = []
        """From the moment at which a reading was sampled to its command [s], by reading."""
        self.pictures: list[float] = []
        """From there to the capture of the first picture that has changed [s], by motion."""
        self._begin = 0, 0
        self._last_input = self._still_since = -np.inf
        self._target: NDArray[np.float64] | None = None
        self._event: float | None = None
        self._seen: dict[str, tuple[float, NDArray[np.int16]]] = {}
        self._noise: dict[str, float] = {}

    def begin_take(self) -> None:
        """Have `to_json` begin here, with a take; the text is about the whole session."""
        self._begin = len(self.commands), len(self.pictures)

    def on_reset(self, first: Transition, seed: int | None) -> None:
        """Begin anew."""
        self._target, self._event, self._seen, self._noise = None, None, {}, {}
        self._still_since = first.time

    def on_step(self, transition: Transition) -> None:
        """Take a step."""
        is_led = transition.notes.get("actor") != "policy"  # meanwhile, readings lead to no command
        sampled, sent = transition.notes.get("input_time") if is_led else None, transition.command_time
        if sampled is not None and sent is not None and sampled > self._last_input:
            self.commands.append(sent - sampled)
            self._last_input = sampled
        self._watch_target(transition, sampled, sent)
        self._watch_pictures(transition)

    def _watch_target(self, transition: Transition, sampled: float | None, sent: float | None) -> None:
        """Note the moment of the reading that begins a motion from rest."""
        target = _numbers(transition.executed or {})
        before, self._target = self._target, target
        if before is None or before.shape != target.shape or np.abs(target - before).max(initial=0.0) <= MOVED:
            return
        if transition.time - self._still_since > REST and sampled is not None and sent is not None:
            self._event = sampled
        self._still_since = transition.time

    def _watch_pictures(self, transition: Transition) -> None:
        for name, frame in transition.observation.get(FRAMES, {}).items():
            when = transition.capture_times.get(f"{FRAMES}/{name}")
            if RGB not in frame or when is None or when == self._seen.get(name, (None,))[0]:
                continue
            picture = frame[RGB][PIXELS, PIXELS].astype(np.int16)
            before, self._seen[name] = self._seen.get(name), (when, picture)
            if before is None:
                continue
            change = float(np.abs(picture - before[1]).mean())
            if self._event is None:
                if transition.time - self._still_since > REST:
                    self._noise[name] = max(change, 0.9 * self._noise.get(name, 0.0))
            elif when > self._event and change > CHANGED * self._noise.get(name, 0.0) + LEAST:
                self.pictures.append(when - self._event)
                self._event = None
        if self._event is not None and transition.time - self._event > PATIENCE:
            self._event = None

    def to_json(self) -> dict[str, Any]:
        """Return the figures of the take [s]: number, median and 99th percentile of both."""
        command, picture = self._begin
        return {"command": _figures(self.commands[command:]), "picture": _figures(self.pictures[picture:])}

    def __str__(self) -> str:
        """Return the figures of the session in a line."""
        both = {"command": _figures(self.commands), "picture": _figures(self.pictures)}
        return (
            "; ".join(
                f"event to {name}: median {1e3 * own['median']:.1f} ms, p99 {1e3 * own['p99']:.1f} ms ({own['count']})"
                for name, own in both.items()
                if own["count"]
            )
            or "no motion was seen"
        )


def _figures(times: list[float]) -> dict[str, Any]:
    if not times:
        return {"count": 0, "median": None, "p99": None}
    return {"count": len(times), "median": float(np.median(times)), "p99": float(np.percentile(times, 99))}


def _numbers(action: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return all numbers of an action, in the order of its keys."""
    parts = [_numbers(own) if isinstance(own, Mapping) else np.ravel(own) for _, own in sorted(action.items())]
    return np.concatenate([np.zeros(0), *parts])
