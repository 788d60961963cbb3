"""The scene that a guard looks at, copy by copy."""

from __future__ import annotations

from typing import Any

import numpy as np

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
    guard._floors.update({(0, 1): 0.001, (1, 0): 0.002})
    envs.reset(options={"reset_mask": np.array([False, True])})
    assert guard._floors == {(0, 1): 0.001}
    envs.close()
