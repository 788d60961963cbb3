"""An observer that keeps what it is shown."""

from __future__ import annotations

from rcs.envs.observer import Observer, Transition


class Notebook(Observer):
    """Keeps what it is shown, episode after episode."""

    def __init__(self) -> None:
        self.seeds: list[int | None] = []
        self.seen: list[Transition] = []
        self.closed = 0

    def on_reset(self, first: Transition, seed: int | None) -> None:
        self.seeds.append(seed)
        self.seen.append(first)

    def on_step(self, transition: Transition) -> None:
        self.seen.append(transition)

    def close(self) -> None:
        self.closed += 1
