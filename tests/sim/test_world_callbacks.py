"""Callbacks that are called between physics steps, in C++ and in Python."""

from __future__ import annotations

import gc
from collections import Counter

import mujoco
import numpy as np
import pytest

from rcs._core import Collision, JointsArrived, JointsAtRest, StepCallback, StepEnd, StepView
from rcs.errors import InvalidSetup, WrongOrder
from rcs.sim.world import Callback, World


@pytest.mark.parametrize("copies", [None, 4])
@pytest.mark.parametrize(("period", "calls"), [(0.002, 50), (0.01, 10), (0.05, 2), (1.0, 0)])
def test_a_periodic_callback_is_called_once_per_period(
    cart: mujoco.MjModel, copies: int | None, period: float, calls: int
) -> None:
    world = World(cart, frequency=30.0, copies=copies, threads=2)
    times: list[tuple[int, float]] = []
    world.core.on_period(Callback(lambda view: times.append((view.copy, view.time))), period)
    for _ in range(3):
        world.advance()
    counted = Counter(copy for copy, _ in times)
    assert [counted[copy] for copy in range(world.copies)] == [calls] * world.copies
    for copy in range(world.copies):
        expected = period * np.arange(1, calls + 1)
        np.testing.assert_allclose([time for other, time in times if other == copy], expected, atol=1e-9)


def test_a_period_shorter_than_a_physics_step_is_refused(cart: mujoco.MjModel) -> None:
    with pytest.raises(InvalidSetup, match="at least one physics step"):
        World(cart).core.on_period(Callback(lambda view: None), 0.0005)


def test_a_period_between_two_multiples_of_the_physics_step_is_refused_with_both(cart: mujoco.MjModel) -> None:
    world = World(cart)
    for period, nearest in ((1 / 30, "0.032 s and 0.034 s"), (0.0015, "0.002 s and 0.004 s")):
        with pytest.raises(InvalidSetup, match=f"nearest are {nearest}"):
            world.on_period(lambda view: None, period)
    for wrong in (0.0005, np.nan, np.inf):
        with pytest.raises(InvalidSetup, match="at least one physics step"):
            world.on_period(lambda view: None, wrong)
    for period in (0.002, 0.3, 0.1 + 0.2, 1e7):
        world.on_period(lambda view: None, period)


@pytest.mark.parametrize("copies", [None, 4])
@pytest.mark.parametrize("kind", ["on_period", "converge_when", "interrupt_when"])
def test_an_exception_of_a_callback_reaches_the_caller(cart: mujoco.MjModel, copies: int | None, kind: str) -> None:
    world = World(cart, stepping="sync", copies=copies, threads=2, max_substeps=5)
    is_broken = True

    def fail(view: StepView) -> bool:
        if is_broken:
            raise LookupError(f"copy {view.copy} has no such thing")
        return False

    callback = Callback(fail)
    arguments = (callback, 0.002) if kind == "on_period" else (callback,)
    getattr(world.core, kind)(*arguments)
    with pytest.raises(LookupError, match="has no such thing"):
        world.advance()
    assert (world.core.ends == StepEnd.failed.value).any()
    is_broken = False
    world.advance()
    np.testing.assert_array_equal(world.core.ends, StepEnd.limit.value)


def test_a_callback_sees_and_writes_the_simulation(cart: mujoco.MjModel) -> None:
    world = World(cart, frequency=50.0)
    seen: list[np.ndarray] = []

    def push(view: StepView) -> None:
        view.xfrc_applied[1, 1] = 0.0
        view.qfrc_applied[0] = 3.0
        seen.append(np.concatenate([view.qpos, view.qvel, view.ctrl, view.site_xpos[0], view.xpos[1]]))
        assert view.contacts == 0

    world.core.on_period(Callback(push), 0.002)
    world.advance()
    assert world.qvel[0] > 0
    assert len(seen) == 10
    last = seen[-1]
    assert last[0] == world.qpos[0]
    assert last[1] == world.qvel[0]


def test_the_addresses_in_a_view_are_those_of_mujoco_itself(cart: mujoco.MjModel) -> None:
    data = mujoco.MjData(cart)
    world = World(cart, data=data)
    seen: list[tuple[int, int]] = []
    world.core.on_period(Callback(lambda view: seen.append((view.model_address, view.data_address))), 0.002)
    world.advance()
    assert set(seen) == {(cart._address, data._address)}


class Steps(StepCallback):
    """Counts its calls per copy since the last reset."""

    def __init__(self) -> None:
        super().__init__()
        self.count: Counter[int] = Counter()

    def call(self, view: StepView) -> bool:
        self.count[view.copy] += 1
        return False

    def reset(self, copy: int) -> None:
        self.count[copy] = 0


def test_reset_tells_callbacks_which_copies_start_anew(cart: mujoco.MjModel) -> None:
    world = World(cart, frequency=50.0, copies=3, threads=2)
    steps = Steps()
    world.core.on_period(steps, 0.002)
    world.advance()
    assert [steps.count[copy] for copy in range(3)] == [10, 10, 10]
    world.reset(np.array([0, 2], np.int32))
    assert [steps.count[copy] for copy in range(3)] == [0, 10, 0]
    world.reset()
    assert [steps.count[copy] for copy in range(3)] == [0, 0, 0]


def test_a_callback_without_a_reset_of_its_own_needs_none(cart: mujoco.MjModel) -> None:
    world = World(cart)
    world.core.on_period(Callback(lambda view: True), 0.002)
    world.advance()
    world.reset()


def test_no_answer_counts_as_no(cart: mujoco.MjModel) -> None:
    world = World(cart, stepping="sync", max_substeps=3)
    world.core.converge_when(Callback(lambda view: None))
    world.core.interrupt_when(Callback(lambda view: None))
    world.advance()
    assert world.core.ends[0] == StepEnd.limit.value


BUILT_IN = {
    "a joint that is not there": lambda: JointsArrived([10**8], [0], 1e-3, 1e-2),
    "a joint before the first": lambda: JointsAtRest([-1], 1e-2, 0.1, 4),
    "an actuator that is not there": lambda: JointsArrived([0], [1], 1e-3, 1e-2),
    "fewer actuators than joints": lambda: JointsArrived([0], [], 1e-3, 1e-2),
    "fewer copies than the world": lambda: JointsAtRest([0], 1e-2, 0.1, 1),
    "no copies": lambda: JointsAtRest([0], 1e-2, 0.1, -1),
    "flags of another model": lambda: Collision(np.ones(9, np.uint8), np.ones(2, np.uint8), 1.0),
}


@pytest.mark.parametrize("kind", ["on_period", "converge_when", "interrupt_when"])
@pytest.mark.parametrize("what", BUILT_IN)
def test_a_callback_that_does_not_fit_the_world_is_refused(cart: mujoco.MjModel, kind: str, what: str) -> None:
    world = World(cart, copies=4, threads=2)
    with pytest.raises(InvalidSetup, match=r"JointsA|Collision"):
        getattr(world.core, kind)(BUILT_IN[what](), *([0.002] if kind == "on_period" else []))
    world.advance()


@pytest.mark.parametrize("kind", ["on_period", "converge_when", "interrupt_when"])
def test_no_callback_is_refused(cart: mujoco.MjModel, kind: str) -> None:
    with pytest.raises((InvalidSetup, TypeError)):
        getattr(World(cart).core, kind)(None, *([0.002] if kind == "on_period" else []))


def test_a_period_of_more_than_2_to_the_31_physics_steps_does_not_become_a_short_one(cart: mujoco.MjModel) -> None:
    world = World(cart)
    calls: list[int] = []
    world.core.on_period(Callback(lambda view: calls.append(view.copy)), (2**32 + 1) * 0.002)
    world.advance()
    assert calls == []
    for wrong in (np.nan, np.inf, -1.0, 1e300):
        with pytest.raises(InvalidSetup, match="at least one physics step"):
            world.core.on_period(Callback(lambda view: None), wrong)


@pytest.mark.parametrize("copies", [None, 2])
def test_a_view_that_is_kept_beyond_its_call_refuses_to_be_used(cart: mujoco.MjModel, copies: int | None) -> None:
    world = World(cart, copies=copies, threads=1)
    kept: list[StepView] = []
    arrays: list[np.ndarray] = []

    def keep(view: StepView) -> None:
        kept.append(view)
        arrays.append(view.qpos)

    world.core.on_period(Callback(keep), 0.002)
    world.advance()
    names = [name for name in dir(StepView) if not name.startswith("_")]
    assert len(names) >= 10
    for name in names:
        with pytest.raises(WrongOrder, match="after the call"):
            getattr(kept[0], name)
    world.close()
    del world
    gc.collect()
    assert all(np.isfinite(array).all() for array in arrays)  # memory that is still there
