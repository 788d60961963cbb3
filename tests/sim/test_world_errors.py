"""Errors and warnings that MuJoCo reports reach the caller, in one copy as in many, and never end the process."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from rcs._core import StepEnd
from rcs.errors import InvalidSetup, SimulationError
from rcs.sim.world import Callback, World

BOXES = "".join(
    f"<body pos='{0.05 * i} 0 {z}'><freejoint/><geom type='box' size='.05 .05 .05'/></body>"
    for i in range(8)
    for z in ["0.04"]
)


def crowd(memory: str) -> mujoco.MjModel:
    """Make boxes that lie in each other, with little memory for their contacts."""
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><size memory='{memory}'/><worldbody><geom type='plane' size='9 9 1'/>{BOXES}</worldbody></mujoco>"
    )


def broken() -> mujoco.MjModel:
    """Make a ball that MuJoCo cannot step: there is no such integrator."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body pos='0 0 1'><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    model.opt.integrator = 99
    return model


@pytest.mark.parametrize("copies", [None, 1, 3])
def test_an_error_of_mujoco_has_its_words_and_leaves_the_state_as_it_was(copies: int | None) -> None:
    world = World(broken(), copies=copies, threads=2)
    world.qvel[..., 0] = 1.0
    before = world.states().copy()
    for _ in range(3):
        with pytest.raises(SimulationError, match="copy 0: mj_step: invalid integrator"):
            world.advance()
    np.testing.assert_array_equal(world.states(), before)
    np.testing.assert_array_equal(world.core.ends, StepEnd.failed.value)
    np.testing.assert_array_equal(world.core.steps, 0)


def test_a_world_goes_on_when_what_mujoco_refused_is_mended() -> None:
    model = broken()
    world, sound = World(model), World(mujoco.MjModel.from_xml_string("<mujoco/>"))
    with pytest.raises(SimulationError):
        world.advance()
    model.opt.integrator = 0
    world.advance()
    assert world.core.ends[0] == StepEnd.period.value
    sound.advance()


def test_an_error_in_a_world_that_a_callback_steps_stays_in_that_world(cart: mujoco.MjModel) -> None:
    inner = World(broken())
    seen: list[str] = []

    def step_the_other() -> None:
        with pytest.raises(SimulationError) as caught:
            inner.advance()
        seen.append(str(caught.value))

    for copies in (None, 2):
        world = World(cart, frequency=500.0, copies=copies, threads=1)
        world.core.on_period(Callback(lambda view: step_the_other()), 0.002)
        world.advance()
        np.testing.assert_array_equal(world.core.ends, StepEnd.period.value)
    assert len(seen) == 3


@pytest.mark.parametrize("copies", [None, 2])
@pytest.mark.parametrize(("memory", "text"), [("20K", "Too many contacts"), ("60K", "number of constraints")])
def test_contacts_that_do_not_fit_into_memory_are_an_error(copies: int | None, memory: str, text: str) -> None:
    world = World(crowd(memory), frequency=500.0, copies=copies, threads=2)
    with pytest.raises(SimulationError, match=text):
        world.advance()
    np.testing.assert_array_equal(world.core.ends, StepEnd.failed.value)


def test_contacts_that_fit_are_none() -> None:
    world = World(crowd("10M"), frequency=500.0)
    world.advance()
    assert world.core.ends[0] == StepEnd.period.value


@pytest.mark.parametrize("copies", [None, 2])
@pytest.mark.parametrize("which", [-1, 0, 3, 1 << 15, 1 << 30, -(2**31)])
def test_a_component_that_does_not_exist_is_refused(cart: mujoco.MjModel, copies: int | None, which: int) -> None:
    with pytest.raises(InvalidSetup, match="one bit of mjtState"):
        World(cart, copies=copies).core.component(which)


@pytest.mark.parametrize("copies", [None, 2])
def test_a_control_that_is_not_a_number_fails_the_step(cart: mujoco.MjModel, copies: int | None) -> None:
    world = World(cart, copies=copies, threads=2)
    world.ctrl[...] = np.nan
    world.advance()
    np.testing.assert_array_equal(world.core.ends, StepEnd.failed.value)
    world.ctrl[...] = 0.0
    world.advance()
    np.testing.assert_array_equal(world.core.ends, StepEnd.period.value)


def test_data_of_another_model_is_refused(cart: mujoco.MjModel) -> None:
    larger = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(InvalidSetup, match="another MjModel"):
        World(larger, data=mujoco.MjData(cart))


def test_what_is_neither_model_nor_data_is_refused(cart: mujoco.MjModel) -> None:
    from rcs import _core

    for wrong in (0, cart._address, None, mujoco.MjData(cart)):
        with pytest.raises(TypeError):
            _core.World.of_copies(wrong, 2, 1, 1, 1, False, 1)  # pyright: ignore[reportArgumentType]
        with pytest.raises(TypeError):
            _core.Renderer(wrong)  # pyright: ignore[reportArgumentType]
        with pytest.raises(TypeError):
            _core.RenderPool(wrong, 1)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("options", [{"threads": -1}, {"threads": 2**40}, {"threads": 1.5}, {"copies": 2**40}])
def test_numbers_of_threads_and_copies_that_cannot_be_are_refused(cart: mujoco.MjModel, options: Any) -> None:
    with pytest.raises(InvalidSetup, match="valid is a whole number from"):
        World(cart, **{"copies": 2, **options})
