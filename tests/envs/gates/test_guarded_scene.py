"""The scene that a guard looks at, copy by copy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from tests.envs.gates.ways import lift_above_plate, make_beside_plate


def test_where_a_copy_holds_an_object_does_not_depend_on_other_copies() -> None:
    with make_beside_plate(on_hit="clip") as env:
        lift_above_plate(env)
        state, setup = env.get_state(), env.setup
    found = []
    for looks in ([1], [0, 1], [1, 0, 1]):
        envs: Any = rcs.make_vec(setup, copies=2)
        envs.reset(seed=0)
        envs.set_state(state)
        world, scene = envs.simulation.world, envs.stack.gates[0]._scene
        place = int(world.model.joint("cuboid").qposadr[0])
        world.qpos[1, place + 2] -= 0.0008  # less than what counts as slipped
        measured = envs.stack.measure()
        joints = scene.vector(measured, measured)
        for copy in looks:
            scene.look(copy, joints[copy])
        found.append(scene.far.clearance(joints[1], 0.05).distance)
        envs.close()
    assert 0.02 < found[0] < 0.04
    np.testing.assert_array_equal(found, found[0])


def test_a_reset_of_some_copies_forgets_distances_of_these_alone() -> None:
    envs: Any = rcs.make_vec("PickCuboid", copies=2, autoreset="Disabled", gates={"Guard": {"on_hit": "clip"}})
    envs.reset(seed=0)
    guard = envs.stack.gates[0]
    guard._floors[0, 1], guard._floors[1, 0] = 0.001, 0.002
    envs.reset(options={"reset_mask": np.array([False, True])})
    np.testing.assert_array_equal(guard._floors, [[-np.inf, 0.001], [-np.inf, -np.inf]])
    envs.close()


def seen_by(env: Any) -> tuple[float, Any]:
    """Return how near a held object is to something for the guard, and how near it may come at least."""
    guard, measured = env.stack.gates[0], env.stack.measure()
    joints = guard._scene.vector(measured, measured)
    guard._scene.look(0, joints)
    return guard._scene.far.clearance(joints, 0.05).distance, guard._floors


@pytest.mark.parametrize("edges", ["fixed", "random"])
def test_a_state_has_what_the_guard_remembers_of_distances_and_of_objects_in_the_hand(edges: str) -> None:
    options: dict[str, Any] = {"task_options": {"edges": edges}, "on_hit": "clip"}
    with make_beside_plate(**options) as env, make_beside_plate(**options) as other:
        lift_above_plate(env)
        env.stack.gates[0]._scene.forget(...)
        before, _ = seen_by(env)
        world = env.simulation.world
        world.qpos[int(world.model.joint("cuboid").qposadr[0]) + 2] -= 0.0008  # less than what counts as slipped
        floors = env.stack.gates[0]._floors
        floors[:] = 0.004, 0.0005
        other.reset(seed=1)
        other.set_state(env.get_state())
        floors[:] = -np.inf
        distance, remembered = seen_by(other)
        np.testing.assert_array_equal(remembered, [0.004, 0.0005])
        assert distance == seen_by(env)[0] == before


def test_a_reset_forgets_what_was_in_the_hand() -> None:
    with make_beside_plate(on_hit="clip") as env:
        lift_above_plate(env)
        seen_by(env)
        scene = env.stack.gates[0]._scene
        assert (scene.held[:, 0] >= 0).any()
        env.reset(seed=0)
        assert (scene.held == -1.0).all()
