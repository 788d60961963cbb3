"""How long a control step lasts."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from fractions import Fraction

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcs._core import Collision, JointsArrived, JointsAtRest, StepEnd
from rcs.errors import InvalidSetup
from rcs.sim.world import Callback, World, control_period

RunProgram = Callable[..., subprocess.CompletedProcess[str]]


def arrived(tolerance: float = 1e-3) -> JointsArrived:
    return JointsArrived([0], [0], tolerance, 1e-2)


def test_30_hz_at_2_ms_alternates_16_17_17_substeps_and_is_exact_in_the_mean(cart: mujoco.MjModel) -> None:
    world = World(cart, frequency=30.0)
    substeps = []
    for _ in range(300):
        world.advance()
        substeps.append(int(world.core.substeps[0]))
        assert world.core.ends[0] == StepEnd.period.value
    assert substeps == [16, 17, 17] * 100
    assert sum(substeps) == 5000
    assert float(world.time) == pytest.approx(10.0, abs=1e-9)
    assert world.core.steps[0] == 300


def test_mujoco_reads_no_clock_for_its_profile(cart: mujoco.MjModel) -> None:
    data = mujoco.MjData(cart)
    World(cart, data=data).advance()
    assert [timer.duration for timer in data.timer] == [0.0] * len(data.timer)


@pytest.mark.parametrize("copies", [None, 3])
def test_a_frequency_that_divides_the_physics_has_equal_steps(cart: mujoco.MjModel, copies: int | None) -> None:
    world = World(cart, frequency=100.0, copies=copies, threads=2)
    for _ in range(20):
        world.advance()
        np.testing.assert_array_equal(world.core.substeps, 5)


def test_copies_count_their_steps_on_their_own(cart: mujoco.MjModel) -> None:
    world = World(cart, frequency=30.0, copies=3, threads=2)
    world.advance()
    world.advance(np.array([1], np.int32))
    np.testing.assert_array_equal(world.core.steps, [1, 2, 1])
    world.reset(np.array([1], np.int32))
    np.testing.assert_array_equal(world.core.steps, [1, 0, 1])
    world.advance()
    np.testing.assert_array_equal(world.core.substeps, [17, 16, 17])
    np.testing.assert_allclose(world.time, [0.066, 0.032, 0.066], atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(frequency=st.floats(0.5, 500.0), step=st.sampled_from([0.001, 0.002]))
def test_the_mean_period_is_that_of_the_frequency(frequency: float, step: float) -> None:
    period = control_period(frequency, step)
    assert isinstance(period, Fraction)
    assert float(period) * step * frequency == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("frequency", [0.0, -1.0, float("nan"), float("inf"), 501.0])
def test_a_frequency_that_makes_no_sense_is_refused(cart: mujoco.MjModel, frequency: float) -> None:
    with pytest.raises(InvalidSetup, match="frequency"):
        World(cart, frequency=frequency)


def test_a_synchronous_step_ends_when_converged(cart: mujoco.MjModel) -> None:
    world = World(cart, stepping="sync", max_substeps=5000)
    world.core.converge_when(arrived())
    world.ctrl[0] = 0.5
    world.advance()
    assert world.core.ends[0] == StepEnd.converged.value
    assert world.qpos[0] == pytest.approx(0.5, abs=1e-3)
    assert abs(world.qvel[0]) < 1e-2
    assert 100 < world.core.substeps[0] < 5000
    assert float(world.time) == pytest.approx(world.core.substeps[0] * 0.002)


def test_a_synchronous_step_ends_at_its_limit(cart: mujoco.MjModel) -> None:
    world = World(cart, stepping="sync", max_substeps=10)
    world.core.converge_when(arrived())
    world.ctrl[0] = 0.5
    world.advance()
    assert world.core.ends[0] == StepEnd.limit.value
    assert world.core.substeps[0] == 10


def test_a_synchronous_step_without_a_convergence_callback_lasts_to_its_limit(cart: mujoco.MjModel) -> None:
    world = World(cart, stepping="sync", max_substeps=7)
    world.advance()
    assert (world.core.ends[0], world.core.substeps[0]) == (StepEnd.limit.value, 7)


def test_all_convergence_callbacks_must_agree(cart: mujoco.MjModel) -> None:
    world = World(cart, stepping="sync", max_substeps=50)
    world.core.converge_when(Callback(lambda view: True))
    world.core.converge_when(Callback(lambda view: view.time > 0.0399))
    world.advance()
    assert (world.core.ends[0], world.core.substeps[0]) == (StepEnd.converged.value, 20)


def test_a_collision_interrupts_a_synchronous_step(cart: mujoco.MjModel) -> None:
    world = World(cart, stepping="sync", max_substeps=5000)
    world.core.converge_when(arrived())
    world.core.interrupt_when(Collision(world.geom_flags(["cart"]), world.geom_flags(["wall"]), 1.0))
    force = world.core.read_force(world.geom_flags(["wall"]), world.geom_flags(["cart"]))
    world.ctrl[0] = 2.0
    world.advance()
    assert world.core.ends[0] == StepEnd.interrupted.value
    assert world.qpos[0] == pytest.approx(1.0, abs=0.03)
    assert world.core.forces[force] > 1.0


def test_an_interrupted_asynchronous_step_lasts_its_period_and_says_so(cart: mujoco.MjModel) -> None:
    world = World(cart, frequency=50.0)
    world.core.interrupt_when(Callback(lambda view: view.time < 0.003))
    world.advance()
    assert (world.core.ends[0], world.core.substeps[0]) == (StepEnd.interrupted.value, 10)
    world.advance()
    assert world.core.ends[0] == StepEnd.period.value


def test_copies_converge_each_at_its_own_time(cart: mujoco.MjModel) -> None:
    world = World(cart, stepping="sync", copies=4, threads=2, max_substeps=5000)
    world.core.converge_when(arrived())
    world.ctrl[:, 0] = [0.0, 0.1, 0.4, 0.9]
    world.advance()
    np.testing.assert_array_equal(world.core.ends, StepEnd.converged.value)
    np.testing.assert_allclose(world.qpos[:, 0], world.ctrl[:, 0], atol=1e-3)
    assert (np.diff(world.core.substeps) > 0).all()


def test_joints_are_at_rest_only_after_they_stood_still_for_the_duration(cart: mujoco.MjModel) -> None:
    world = World(cart, stepping="sync", max_substeps=5000)
    world.core.converge_when(JointsAtRest([0], 1e-2, 0.1, 1))
    world.advance()
    assert world.core.ends[0] == StepEnd.converged.value
    assert world.core.substeps[0] == pytest.approx(51, abs=1)


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"copies": 0}, InvalidSetup, "copies is 0"),
        ({"max_substeps": 0}, InvalidSetup, "max_substeps"),
        ({"stepping": "fast"}, InvalidSetup, "stepping is 'fast'; valid: 'async', 'sync', 'realtime'"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(cart, arguments, error, text) -> None:
    with pytest.raises(error, match=text):
        World(cart, **arguments)


def test_data_and_copies_exclude_each_other(cart: mujoco.MjModel) -> None:
    with pytest.raises(InvalidSetup, match="not both"):
        World(cart, data=mujoco.MjData(cart), copies=2)


@pytest.mark.parametrize("frequency", [1e-9, 1e-300, 9.9e-7])
def test_a_frequency_that_is_too_low_to_count_is_refused_with_what_is_valid(
    cart: mujoco.MjModel, frequency: float
) -> None:
    with pytest.raises(InvalidSetup, match=f"frequency is {frequency} Hz; valid is from 1e-06 Hz"):
        World(cart, frequency=frequency)
    World(cart, frequency=1e-6)


def test_a_model_without_a_time_step_is_refused(cart: mujoco.MjModel) -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    for wrong in (0.0, -0.002, float("nan"), 1e-12):
        model.opt.timestep = wrong
        with pytest.raises(InvalidSetup, match="time step"):
            World(model)


def test_a_ratio_with_long_terms_does_not_overflow_after_many_steps() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco><option timestep='0.001234567'/></mujoco>")
    period = control_period(10 * np.pi, 0.001234567)
    world = World(model, frequency=10 * np.pi)
    steps = 68_000
    for _ in range(steps):
        world.advance()
        assert world.core.substeps[0] in (25, 26)
    assert float(world.time) == pytest.approx(int(steps * period) * 0.001234567)


def test_ctrl_c_ends_a_long_step_at_once(run_program: RunProgram) -> None:
    program = """
        import os, signal, threading, time, sys
        import mujoco
        from rcs.sim.world import World
        copies = None if sys.argv[1] == "one" else 8
        world = World(mujoco.MjModel.from_xml_string("<mujoco/>"), frequency=1e-5, copies=copies, threads=2)
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
        start = time.perf_counter()
        try:
            world.advance()
        except KeyboardInterrupt:
            print(time.perf_counter() - start < 1.5)
    """
    for copies in ("one", "many"):
        answer = run_program(program, copies)
        assert answer.stdout.strip() == "True", answer.stderr
