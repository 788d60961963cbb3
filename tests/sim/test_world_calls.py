"""A world takes one call at a time, from any thread, until it is closed."""

from __future__ import annotations

import gc
import subprocess
import threading
import weakref
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from rcs._core import StepCallback
from rcs.errors import WrongOrder
from rcs.sim import RobotPlacement
from rcs.sim.robot import SimRobot
from rcs.sim.world import Callback, World

RunProgram = Callable[..., subprocess.CompletedProcess[str]]

CALLS: dict[str, Callable[[World], Any]] = {
    "advance": lambda w: w.advance(),
    "refresh": lambda w: w.refresh(),
    "reset": lambda w: w.reset(),
    "get_state": lambda w: w.core.get_state(0),
    "set_state": lambda w: w.core.set_state(np.zeros(w.core.state_size)),
    "keep_initial_state": lambda w: w.core.keep_initial_state(),
    "on_period": lambda w: w.core.on_period(Callback(lambda view: None), 0.002),
    "converge_when": lambda w: w.core.converge_when(Callback(lambda view: None)),
    "interrupt_when": lambda w: w.core.interrupt_when(Callback(lambda view: None)),
    "read_pose": lambda w: w.core.read_pose(0, 0),
    "read_body_pose": lambda w: w.core.read_body_pose(0, 0),
    "read_force": lambda w: w.core.read_force(np.ones(2, np.uint8), np.ones(2, np.uint8)),
    "read_opening": lambda w: w.core.read_opening([0], 0.0, 1.0),
    "expand": lambda w: w.core.expand("body_mass"),
    "expanded": lambda w: w.core.expanded("body_mass"),
    "set_constants": lambda w: w.core.set_constants(),
    "close": lambda w: w.close(),
}
NEEDS_NO_TURN: dict[str, Callable[[World], Any]] = {
    "component": lambda w: w.core.component(1),
    "states": lambda w: w.states(),
}


class Wait(StepCallback):
    """Stops the world in the middle of a step until it is told to go on."""

    def __init__(self) -> None:
        super().__init__()
        self.is_stepping, self.go_on = threading.Event(), threading.Event()

    def call(self, view: Any) -> bool:
        self.is_stepping.set()
        assert self.go_on.wait(20.0)
        return False


@pytest.mark.parametrize("copies", [None, 2])
def test_a_call_from_another_thread_during_a_step_is_refused(cart: mujoco.MjModel, copies: int | None) -> None:
    world, wait = World(cart, copies=copies, threads=1), Wait()
    world.core.on_period(wait, 0.002)
    thread = threading.Thread(target=world.advance, name="steps")
    thread.start()
    try:
        assert wait.is_stepping.wait(20.0)
        for name, call in CALLS.items():
            with pytest.raises(WrongOrder, match=f"{name} was called while the world is already stepping"):
                call(world)
    finally:
        wait.go_on.set()
        thread.join()
    world.advance()
    assert world.core.steps[0] == 2


@pytest.mark.parametrize("copies", [None, 2])
@pytest.mark.parametrize("name", CALLS)
def test_a_call_from_a_callback_of_the_same_world_is_refused(
    cart: mujoco.MjModel, copies: int | None, name: str
) -> None:
    world = World(cart, frequency=500.0, copies=copies, threads=2)
    is_nested = True
    world.core.on_period(Callback(lambda view: CALLS[name](world) if is_nested else None), 0.002)
    with pytest.raises(WrongOrder, match=f"{name} was called while the world is already stepping"):
        world.advance()
    is_nested = False
    world.advance()
    world.close()


def test_many_threads_that_step_one_world_do_not_crash(run_program: RunProgram) -> None:
    program = """
        import sys, threading
        import mujoco
        from rcs.errors import WrongOrder
        from rcs.sim.world import World
        model = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
        )
        copies = None if sys.argv[1] == "one" else 4
        world = World(model, copies=copies, threads=2)
        done = refused = 0
        def step():
            global done, refused
            for _ in range(200):
                try:
                    world.advance()
                    if copies:
                        world.field("body_mass")
                    done += 1
                except WrongOrder:
                    refused += 1
        threads = [threading.Thread(target=step) for _ in range(4)]
        [t.start() for t in threads]
        [t.join() for t in threads]
        print(done > 0, done + refused == 800)
    """
    for copies in ("one", "many"):
        answer = run_program(program, copies)
        assert answer.stdout.strip() == "True True", answer.stderr


@pytest.mark.parametrize("copies", [None, 3])
def test_a_closed_world_refuses_every_call_and_its_arrays_keep_their_values(
    cart: mujoco.MjModel, copies: int | None
) -> None:
    world = World(cart, copies=copies, threads=2)
    world.core.read_body_pose(1, 0)
    world.core.on_period(Callback(lambda view: None), 0.002)
    world.refresh()
    world.ctrl[...] = 0.5
    world.advance()
    kept = [world.qpos, world.qvel, world.ctrl, world.poses, world.core.steps]
    before = [array.copy() for array in kept]
    world.close()
    world.close()
    assert not world.core.is_open
    for name, call in (CALLS | NEEDS_NO_TURN).items():
        if name != "close":
            with pytest.raises(WrongOrder, match="after close"):
                call(world)
    np.testing.assert_array_equal(world.qpos, before[0])
    del world
    gc.collect()
    for array, expected in zip(kept, before, strict=True):
        np.testing.assert_array_equal(array, expected)
        array[...] = 1  # memory that is still there


def threads() -> int:
    """Return how many threads this process has, those of C++ included."""
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("Threads:"))


@pytest.mark.parametrize("is_closed", [True, False])
def test_a_world_whose_callback_refers_to_it_leaves_nothing_behind(cart: mujoco.MjModel, is_closed: bool) -> None:
    gc.collect()
    before = threads()
    left: list[weakref.ref[World]] = []
    for _ in range(10):
        world = World(cart, copies=4, threads=4)
        world.core.on_period(Callback(lambda view, world=world: bool(world.qpos[0, 0] > 1e9)), 0.002)
        world.advance()
        if is_closed:
            world.close()
        left.append(weakref.ref(world))
    del world
    gc.collect()
    assert [ref() for ref in left] == [None] * 10
    assert threads() == before


def test_a_robot_keeps_no_threads_of_a_closed_world(lab: mujoco.MjModel, placement: RobotPlacement) -> None:
    gc.collect()
    before = threads()
    robot = SimRobot(World(lab, copies=4, threads=4), placement)
    robot.go_home()
    robot.world.advance()
    numbers = robot._memory.copy()
    robot.world.close()
    gc.collect()
    assert threads() == before
    np.testing.assert_array_equal(robot._memory, numbers)


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="there is no fork here")
def test_a_child_of_a_fork_is_told_so_and_ends(run_program: RunProgram) -> None:
    program = """
        import os, sys
        import mujoco
        from rcs.errors import WrongOrder
        from rcs.sim.world import World
        model = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
        )
        world, single = World(model, copies=4, threads=3), World(model)
        other = World(model, copies=4, threads=3)
        world.advance()
        child = os.fork()
        if child == 0:
            single.advance()  # has no threads
            try:
                world.advance()
            except WrongOrder as error:
                print("after a fork" in str(error), flush=True)
            world.close()
            del world
            sys.exit(7)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
        world.advance()
    """
    answer = run_program(program)
    assert answer.stdout.split() == ["True", "7"], answer.stderr
    assert answer.returncode == 0


def test_a_daemon_thread_that_steps_does_not_spoil_the_end_of_the_program(run_program: RunProgram) -> None:
    program = """
        import sys, threading, time
        import mujoco
        from rcs.sim.world import Callback, World
        model = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
        )
        world = World(model, copies=None if sys.argv[1] == "one" else 4, threads=2)
        callbacks = {"short": lambda view: None, "asleep": lambda view: time.sleep(0.01)}
        if sys.argv[2] in callbacks:
            world.core.on_period(Callback(callbacks[sys.argv[2]]), 0.002)
        def step():
            while True:
                world.advance()
        threading.Thread(target=step, daemon=True).start()
        time.sleep(0.1)
    """
    for copies in ("one", "many"):
        for callback in ("none", "short", "asleep"):
            answer = run_program(program, copies, callback)
            assert (answer.returncode, answer.stderr) == (0, "")


def test_by_default_there_is_a_thread_for_each_cpu_that_the_process_may_use(run_program: RunProgram) -> None:
    program = """
        import os
        import mujoco
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        from rcs.sim.world import World
        print(World(mujoco.MjModel.from_xml_string("<mujoco/>"), copies=64).core.threads)
    """
    assert run_program(program).stdout.strip() == "1"


def test_threads_that_cannot_start_are_an_error_and_not_the_end(run_program: RunProgram) -> None:
    program = """
        import resource
        import mujoco
        from rcs.sim.world import World
        model = mujoco.MjModel.from_xml_string("<mujoco/>")
        used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + (200 << 20),) * 2)
        try:
            World(model, copies=256, threads=256)
        except RuntimeError as error:
            print("of 255 threads could be started" in str(error))
        World(model, copies=2, threads=2).advance()
    """
    answer = run_program(program)
    assert (answer.stdout.strip(), answer.returncode) == ("True", 0), answer.stderr
