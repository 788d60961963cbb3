from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

import rcs
from rcs.envs.step.observers import Observers
from tests.envs.notebook import Notebook


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


def test_a_copy_is_shown_its_own_row_of_actions_that_come_in_lists() -> None:
    envs, notebook = rcs.make_vec("Free", copies=2), Notebook()
    envs.add_observer(notebook, copy=1)
    envs.reset(seed=0)
    given: Any = {"joints": [[0.0] * 7, [0.01] * 7], "gripper": [[1.0], [0.0]]}
    envs.step(given)
    action: Any = notebook.seen[-1].action
    np.testing.assert_array_equal(action["joints"], np.full(7, 0.01))
    np.testing.assert_array_equal(action["gripper"], [0.0])
    envs.close()


def test_notes_are_shown_once_and_those_of_a_lost_step_never(make_bench: Callable[..., Any]) -> None:
    bench, notebook = make_bench(), Notebook()
    bench.env.add_observer(notebook)
    bench.env.reset()
    bench.env.note(actor="page")
    bench.arm.set_fault("touched something")
    bench.env.step(bench.env.action_space.sample())
    bench.env.recover()
    bench.env.reset()
    bench.env.note(actor="agent")
    bench.env.reset()
    bench.env.step(bench.env.action_space.sample())
    assert [dict(one.notes) for one in notebook.seen] == [{}, {}, {"actor": "agent"}, {}]
