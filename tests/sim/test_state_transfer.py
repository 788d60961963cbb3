"""States go from one scene to another that differs in cameras, and back."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import rcs
from rcs.envs.assemble import compose
from rcs.errors import InvalidSetup
from rcs.setups.make import resolve
from rcs.sim.state_transfer import StateTransfer


def model(**options: object) -> mujoco.MjModel:
    return compose(resolve(rcs.Setup(**options))).compile()  # pyright: ignore[reportArgumentType]


def state_of(source: mujoco.MjModel) -> np.ndarray:
    """Return a state in which no two numbers are alike."""
    size = mujoco.mj_stateSize(source, mujoco.mjtState.mjSTATE_INTEGRATION.value)
    return np.random.default_rng(0).uniform(size=size)


def test_between_equal_scenes_nothing_changes() -> None:
    scene = model()
    state = state_of(scene)
    np.testing.assert_array_equal(StateTransfer(scene, scene)(state), state)


def test_there_and_back_with_cameras_is_the_identity() -> None:
    plain, seen = model(), model(cameras=("wrist", "side"))
    state = state_of(plain)
    there, back = StateTransfer(plain, seen), StateTransfer(seen, plain)
    np.testing.assert_array_equal(back(there(state)), state)
    rows = np.stack([state, 2 * state])
    np.testing.assert_array_equal(there(rows)[0], there(state))


def test_what_moves_moves_alike_and_forces_act_on_the_same_bodies() -> None:
    plain, seen = model(), model(cameras=("side", "wrist"))
    state = state_of(plain)
    whole = mujoco.mjtState.mjSTATE_INTEGRATION.value
    one, other = mujoco.MjData(plain), mujoco.MjData(seen)
    mujoco.mj_setState(plain, one, state, whole)
    mujoco.mj_setState(seen, other, StateTransfer(plain, seen)(state), whole)
    for name in ("qpos", "qvel", "ctrl", "qacc_warmstart", "eq_active"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.time == other.time
    for i in range(plain.nbody):
        name = plain.body(i).name
        np.testing.assert_array_equal(one.xfrc_applied[i], other.xfrc_applied[seen.body(name).id])
    for camera in ("side/camera", "wrist/camera"):
        assert not other.xfrc_applied[seen.body(camera).id].any()


def test_scenes_with_other_joints_are_refused() -> None:
    with pytest.raises(InvalidSetup, match="joints"):
        StateTransfer(model(), model(robot="ur5e"))


def test_a_state_of_another_size_is_refused() -> None:
    scene = model()
    with pytest.raises(InvalidSetup, match=r"3 numbers.*moves differently"):
        StateTransfer(scene, scene)(np.zeros(3))
