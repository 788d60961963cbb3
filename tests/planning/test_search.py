"""OMPL's planners by name."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from rcs.errors import PlanningFailed, UnknownName
from rcs.planning import PLANNERS
from tests.planning.scene import LEFT, RIGHT, make_planner

pytestmark = pytest.mark.extras


@pytest.mark.parametrize("name", [*PLANNERS, "KPIECE1", "InformedRRTstar"])
def test_every_planner_finds_a_way_and_the_same_again(name: str) -> None:
    planner = make_planner(planner=name, time_limit=60.0, iterations=60)
    first, again = (planner.plan(LEFT, RIGHT, seed=2) for _ in range(2))
    np.testing.assert_array_equal(first.waypoints, again.waypoints)
    assert planner.checker.free_rows(first.at(np.linspace(0.0, 1.0, 1500)), 0.002).all()


def test_a_name_that_no_planner_has_lists_those_that_there_are() -> None:
    with pytest.raises(UnknownName, match="Did you mean 'RRTConnect'"):
        make_planner(planner="RRTConect").plan(LEFT, RIGHT)


def test_without_a_way_the_search_ends_in_time() -> None:
    planner = make_planner(planner="RRT", time_limit=1e-9)
    with pytest.raises(PlanningFailed, match="no path in") as caught:
        planner.plan(LEFT, RIGHT)
    assert caught.value.reason == "time"


def test_a_program_that_has_planned_ends_without_a_word() -> None:
    program = (
        "import rcs\n"
        "with rcs.make('PickCuboid', robot='fr3', task_options={'obstacles': 4}) as env:\n"
        "    env.reset(seed=0)\n"
        "    planner = rcs.envs.planner_for(env)\n"
        "    planner.plan(planner.joints, planner.joints + 0.2, seed=1)\n"
        "    planner.plan(planner.joints, rcs.Pose.from_rpy((0.4, 0.3, 0.3), (3.14159, 0, 0)), seed=1)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
