"""Planners made from environments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs import planner_for
from rcs.envs.planner_for import ScenePlanner
from rcs.errors import InvalidSetup, UnknownName, WrongOrder
from rcs.robots.fr3 import FR3
from rcs.sim.randomisation import Randomisation


def test_a_planner_sees_the_scene_as_it_is_and_looks_again_when_asked() -> None:
    with rcs.make("PickCuboid", robot="fr3", task_options={"obstacles": 4}) as env:
        env.reset(seed=0)
        planner = planner_for(env)
        before = planner.checker.clearance(planner.joints, 1.0).distance
        data = env.simulation.world.data
        assert data is not None
        tcp = data.site("fr3/gripper/tcp").xpos
        data.mocap_pos[0] = tcp  # a post where the hand is
        assert planner.checker.clearance(planner.joints, 1.0).distance == before
        planner.look()
        assert planner.checker.clearance(planner.joints, 1.0).distance < 0.0


@pytest.mark.parametrize("ranges", [None, Randomisation.off(table_height=0.05)], ids=["sizes", "table"])
def test_a_planner_is_of_the_sizes_of_its_episode(ranges: Randomisation | None) -> None:
    with rcs.make("PickCuboid", task_options={"distractors": 4}, randomisation=ranges) as env:
        env.reset(seed=0)
        planner = planner_for(env)
        planner.look()
        env.reset(seed=3)
        with pytest.raises(WrongOrder, match="make a new one"):
            planner.look()
        planner_for(env).look()


def test_a_planner_of_a_copy_sees_what_is_around_that_copy() -> None:
    options: dict[str, Any] = {"task_options": {"obstacles": 4, "distractors": 4}}
    envs = rcs.make_vec("PickCuboid", copies=2, **options)
    envs.reset(seed=3)
    rows = np.array(FR3.home) + np.random.default_rng(0).normal(0.0, 0.3, (20, 7))
    found = []
    for copy in range(2):
        planner = ScenePlanner(envs.simulation.world, envs.robots["fr3"], copy=copy)
        found.append(planner.checker.clearance_rows(rows, 1.0)[0])
        with rcs.make("PickCuboid", **options) as env:
            env.reset(seed=3 + copy)
            np.testing.assert_array_equal(found[copy], planner_for(env).checker.clearance_rows(rows, 1.0)[0])
    assert (found[0] != found[1]).any()
    envs.close()


def test_what_is_attached_moves_with_the_gripper() -> None:
    with rcs.make("PickCuboid", robot="fr3") as env:
        env.reset(seed=0)
        planner = planner_for(env)
        loose = len(planner.checker.pairs)
        planner.attach("cuboid")
        held = {tuple(pair) for pair in planner.checker.pairs.tolist()}
        cuboid, table = (env.simulation.world.model.geom(name).id for name in ("cuboid", "table top"))
        assert (min(cuboid, table), max(cuboid, table)) in held
        planner.detach("cuboid")
        assert len(planner.checker.pairs) == loose
        with pytest.raises(UnknownName, match="Did you mean 'cuboid'"):
            planner.attach("cubiod")


def test_one_of_two_robots_is_named_and_the_other_one_is_an_obstacle() -> None:
    with rcs.make("LiftBar", robot="dual_fr3") as env:
        env.reset(seed=0)
        with pytest.raises(InvalidSetup, match="name one"):
            planner_for(env)
        with pytest.raises(UnknownName):
            planner_for(env, "middle")
        first, second = env.robots
        planner = planner_for(env, first)
        model = env.simulation.world.model
        bodies = {model.body(model.geom_bodyid[g]).name for g in np.unique(planner.checker.pairs)}
        assert any(name.startswith(f"{second}/") for name in bodies)
        assert planner.checker.dof == 7
