from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from rcs.envs.step.observers import Observers


class Seen:
    """Keeps which of its calls were made."""

    def __init__(self) -> None:
        self.ends: list[str] = []

    def on_end(self, end: str, reasons: Any) -> None:
        self.ends.append(end)


def observers(copies: int) -> Any:
    return Observers(Any, Any, SimpleNamespace(world=SimpleNamespace(leading=(copies,))))  # type: ignore[arg-type]


def test_an_observer_that_is_removed_sees_no_more_and_the_others_do() -> None:
    shown, (stays, leaves) = observers(2), (Seen(), Seen())
    for one in (stays, leaves):
        shown.add(one)
    shown.on_end("fault", {})
    shown.remove(leaves)
    shown.on_end("closed", {})
    assert (stays.ends, leaves.ends) == (["fault", "closed"], ["fault"])


def test_the_end_of_a_copy_is_shown_to_its_observers_alone() -> None:
    shown, (first, second) = observers(2), (Seen(), Seen())
    shown.add(first)
    shown.add(second, copy=1)
    shown.on_end("fault", {}, copy=1)
    shown.on_end("closed", {})
    assert (first.ends, second.ends) == (["closed"], ["fault", "closed"])
    assert np.ndim(shown.after_hold) == 0
