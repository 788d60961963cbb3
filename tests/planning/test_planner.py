"""Planning past obstacles by OMPL's planners."""

from __future__ import annotations

import pickle
import subprocess
import sys

import numpy as np
import pytest

from rcs.errors import InvalidSetup, PlanningFailed, UnknownName
from rcs.planning import Path, Planner
from rcs.spatial import Pose
from tests.planning.scene import HOME, LEFT, RIGHT, make_planner

pytestmark = pytest.mark.extras


@pytest.fixture
def planner() -> Planner:
    return make_planner(time_limit=30.0)


def require_free(planner: Planner, path: Path, margin: float = 0.0) -> None:
    rows = path.at(np.linspace(0.0, 1.0, 2000))
    assert planner.checker.free_rows(rows, margin).all()


def test_a_path_leads_around_the_wall_and_the_timed_one_does(planner: Planner) -> None:
    assert planner.checker.first_hit(LEFT, RIGHT) is not None
    path = planner.plan(LEFT, RIGHT, seed=1)
    np.testing.assert_allclose(path.waypoints[[0, -1]], [LEFT, RIGHT])
    require_free(planner, path, margin=0.002)
    samples = planner.time(path).sampled(500.0)
    assert planner.checker.free_rows(samples.positions, 0.002).all()
    assert (np.abs(samples.jerks) <= planner.limits.jerk).all()


def test_the_same_seed_gives_the_same_path_and_another_one_another(planner: Planner) -> None:
    first, again, other = (planner.plan(LEFT, RIGHT, seed=seed).waypoints for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert first.shape != other.shape or not np.array_equal(first, other)


def test_a_pose_is_reached_by_the_nearest_of_several_solutions(planner: Planner) -> None:
    assert planner.kinematics is not None
    pose = planner.kinematics.forward(RIGHT)
    roots = planner.goals(pose, start=LEFT)
    assert len(roots) > 3
    for q in roots:
        reached = planner.kinematics.forward(q)
        np.testing.assert_allclose(reached.translation, pose.translation, atol=2e-4)
        assert (q >= planner.checker.joint_lower).all()
        assert (q <= planner.checker.joint_upper).all()
    path = planner.plan(LEFT, pose, seed=2)
    np.testing.assert_allclose(planner.kinematics.forward(path.waypoints[-1]).translation, pose.translation, atol=2e-4)
    require_free(planner, path)


def test_a_start_in_collision_names_the_pair(planner: Planner) -> None:
    inside = np.array(LEFT)
    inside[0] = 0.0
    with pytest.raises(PlanningFailed, match=r"start is in collision: .*wall.* and .*fr3") as caught:
        planner.plan(inside, RIGHT)
    assert caught.value.reason == "start"
    assert pickle.loads(pickle.dumps(caught.value)).reason == "start"
    with pytest.raises(PlanningFailed, match="goal is in collision") as caught:
        planner.plan(LEFT, inside)
    assert caught.value.reason == "goal"


def test_of_several_goals_those_in_collision_are_left_out(planner: Planner) -> None:
    inside = np.array(LEFT)
    inside[0] = 0.0
    path = planner.plan(LEFT, [inside, RIGHT], seed=1)
    np.testing.assert_allclose(path.waypoints[-1], RIGHT)


def test_a_goal_beside_something_does_not_count_where_others_keep_the_margin(planner: Planner) -> None:
    low, high = 0.0, LEFT[0]  # inside the wall, and free of it
    for _ in range(40):
        middle = (low + high) / 2
        is_near = planner.checker.clearance(np.array([middle, *LEFT[1:]]), 0.1).distance < 3e-4
        low, high = (middle, high) if is_near else (low, middle)
    near = np.array([high, *LEFT[1:]])
    path = planner.plan(LEFT, [near, RIGHT], seed=1)
    np.testing.assert_allclose(path.waypoints[-1], RIGHT)
    require_free(planner, path, margin=0.002)
    np.testing.assert_allclose(planner.plan(LEFT, near, seed=1).waypoints[-1], near)


def test_a_pose_out_of_reach_says_so(planner: Planner) -> None:
    with pytest.raises(PlanningFailed, match="No joints inside the limits reach") as caught:
        planner.plan(HOME, Pose((2.0, 0.0, 0.5)))
    assert caught.value.reason == "unreachable"


def test_without_a_way_the_search_ends_in_time(planner: Planner) -> None:
    closed = Planner(planner.checker, planner.limits, margin=0.0, planner=planner.planner, time_limit=1e-9)
    with pytest.raises(PlanningFailed, match="no path in 1e-09 s") as caught:
        closed.plan(LEFT, RIGHT)
    assert caught.value.reason == "time"


def test_a_grasped_object_is_carried_clear_of_everything() -> None:
    planner = make_planner(time_limit=30.0)
    bare = planner.plan(LEFT, RIGHT, seed=1)
    from tests.planning.scene import make_model  # names of its bodies

    model, joints = make_model()
    qpos = model.qpos0.copy()
    qpos[model.jnt_qposadr[joints]] = LEFT
    planner.checker.set_state(qpos)
    hand, stick = model.body("fr3/gripper/hand").id, model.body("stick").id
    planner.checker.attach(stick, hand, Pose((0.0, 0.0, 0.12), (0.0, 0.7071067811865476, 0.0, 0.7071067811865476)))
    path = planner.plan(LEFT, RIGHT, seed=1)
    require_free(planner, path)
    assert not np.array_equal(bare.waypoints, path.waypoints)
    pairs = {tuple(pair) for pair in planner.checker.pairs.tolist()}
    wall, geom = model.geom("wall").id, model.geom("stick").id
    assert (min(wall, geom), max(wall, geom)) in pairs


def test_what_makes_no_sense_is_refused(planner: Planner) -> None:
    with pytest.raises(InvalidSetup, match="7 finite joints"):
        planner.plan(LEFT[:6], RIGHT)
    with pytest.raises(InvalidSetup, match=r"start has the shape \(2, 7\); valid are 7 finite joints"):
        planner.plan([LEFT, HOME], RIGHT)
    with pytest.raises(InvalidSetup, match=r"Joint 4 of the goal is 1\.0000 rad; valid is -3\.0421 to -0\.1518"):
        planner.plan(LEFT, [*RIGHT[:3], 1.0, *RIGHT[4:]])
    with pytest.raises(InvalidSetup, match="margin"):
        Planner(planner.checker, planner.limits, margin=-1.0)
    with pytest.raises(InvalidSetup, match="no kinematics"):
        Planner(planner.checker, planner.limits).plan(LEFT, Pose())


@pytest.mark.parametrize("name", ["RRT", "RRTConnect", "RRTstar", "FMT", "BITstar", "KPIECE1", "InformedRRTstar"])
def test_every_planner_finds_a_way_and_the_same_again(name: str) -> None:
    planner = make_planner(planner=name, time_limit=60.0, iterations=60)
    first, again = (planner.plan(LEFT, RIGHT, seed=2) for _ in range(2))
    np.testing.assert_array_equal(first.waypoints, again.waypoints)
    assert planner.checker.free_rows(first.at(np.linspace(0.0, 1.0, 1500)), 0.002).all()


def test_a_name_that_no_planner_has_lists_those_that_there_are() -> None:
    with pytest.raises(UnknownName, match="Did you mean 'RRTConnect'"):
        make_planner(planner="RRTConect").plan(LEFT, RIGHT)


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
