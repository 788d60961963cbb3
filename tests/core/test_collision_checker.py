"""The collision checker in the scenes of the built-in robots."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

import rcs
from rcs._core import CollisionChecker
from rcs.envs.env import Env
from rcs.errors import InvalidSetup


@pytest.fixture(params=["fr3", "ur5e", "so101"], scope="module")
def env(request: pytest.FixtureRequest) -> Iterator[Env]:
    env = rcs.make("PickCuboid", robot=request.param, task_options={"distractors": 6})
    with env:
        env.reset(seed=1)
        yield env


def joints_of(env: Env) -> list[int]:
    model, robot = env.simulation.world.model, next(iter(env.robots.values()))
    return [model.joint(robot.prefix + name).id for name in robot.arm.joints]


@pytest.fixture
def checker(env: Env) -> CollisionChecker:
    world = env.simulation.world
    checker = CollisionChecker(world.model, [joints_of(env)])
    checker.set_state(world.qpos)
    return checker


def random_joints(checker: CollisionChecker, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(checker.joint_lower, checker.joint_upper, (count, checker.dof))


def data_at(env: Env, checker: CollisionChecker, q: np.ndarray) -> mujoco.MjData:
    world = env.simulation.world
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.qpos
    data.qpos[world.model.jnt_qposadr[checker.joints]] = q
    mujoco.mj_kinematics(world.model, data)
    return data


def distance_between(model: mujoco.MjModel, data: mujoco.MjData, a: int, b: int) -> float:
    """Return MuJoCo's distance, or minus the radius of a capsule whose axis has a point in a box."""
    distance = mujoco.mj_geomDistance(model, data, a, b, 1.0, None)
    kinds = {int(model.geom_type[geom]): geom for geom in (a, b)}
    if set(kinds) == {mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX} and distance > 0:
        capsule, box = kinds[mujoco.mjtGeom.mjGEOM_CAPSULE], kinds[mujoco.mjtGeom.mjGEOM_BOX]
        along = np.linspace(-1.0, 1.0, 2001)[:, None] * model.geom_size[capsule, 1]
        points = data.geom_xpos[capsule] + along * data.geom_xmat[capsule].reshape(3, 3)[:, 2]
        inside = np.abs((points - data.geom_xpos[box]) @ data.geom_xmat[box].reshape(3, 3)) < model.geom_size[box]
        if inside.all(axis=1).any():
            return -float(model.geom_size[capsule, 0])
    return distance


def test_an_arm_that_reaches_through_a_table_is_not_free() -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[2.0, 2.0, 0.02], pos=[0.0, 0.0, -0.02])
    arm = spec.worldbody.add_body(name="arm", pos=[0.0, 0.0, 0.3])
    arm.add_joint(name="joint", axis=[0.0, 1.0, 0.0])
    arm.add_geom(
        name="arm", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.04, 0.2, 0.0], pos=[0.3, 0.0, 0.0], quat=[1, 0, 1, 0]
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    checker = CollisionChecker(model, [[0]])
    for angle, is_free in ((0.0, True), (1.5, False), (np.pi / 2, False), (-1.0, True)):
        data.qpos[:] = angle
        mujoco.mj_kinematics(model, data)
        table, capsule = model.geom("table").id, model.geom("arm").id
        assert checker.is_free(np.array([angle]), 0.001) is is_free
        assert checker.clearance(np.array([angle]), 1.0).distance == pytest.approx(
            distance_between(model, data, table, capsule), abs=1e-9
        )
    assert checker.first_hit(np.zeros(1), np.array([1.5])) is not None


def test_clearance_is_the_smallest_distance_of_any_pair(env: Env, checker: CollisionChecker) -> None:
    rows = random_joints(checker, 40)
    distances, geoms = checker.clearance_rows(rows, 1.0, threads=2)
    for q, distance, pair in zip(rows, distances, geoms, strict=True):
        data = data_at(env, checker, q)
        every = [distance_between(env.simulation.world.model, data, a, b) for a, b in checker.pairs]
        assert distance == pytest.approx(min(every), abs=1e-9)
        own = distance_between(env.simulation.world.model, data, *pair)
        assert own == pytest.approx(distance, abs=1e-9)


def test_what_is_free_makes_no_contact_of_a_checked_pair(env: Env, checker: CollisionChecker) -> None:
    model, pairs = env.simulation.world.model, {tuple(pair) for pair in checker.pairs.tolist()}
    rows = random_joints(checker, 200, seed=2)
    for q, is_free in zip(rows, checker.free_rows(rows), strict=True):
        data = data_at(env, checker, q)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        touching = {tuple(sorted(c.geom.tolist())) for c in data.contact[: data.ncon] if c.dist < 0}
        # MuJoCo finds no contact of a capsule whose axis passes through a box.
        is_pierced = any(distance_between(model, data, a, b) < 0 for a, b in pairs)
        assert is_free == (not touching & pairs and not is_pierced)


def test_every_contact_that_joints_can_make_belongs_to_a_checked_pair(env: Env, checker: CollisionChecker) -> None:
    """MuJoCo's own choice of pairs is the reference; a pair that no joint moves has the same distance everywhere."""
    model, pairs = env.simulation.world.model, {tuple(pair) for pair in checker.pairs.tolist()}
    always: set[tuple[int, ...]] | None = None
    seen: set[tuple[int, ...]] = set()
    for q in random_joints(checker, 200, seed=3):
        data = data_at(env, checker, q)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        touching = {tuple(sorted(c.geom.tolist())) for c in data.contact[: data.ncon]}
        always = touching if always is None else always & touching
        seen |= touching
    assert always is not None
    assert seen - always <= pairs


def test_a_free_motion_is_free_at_every_sample(checker: CollisionChecker) -> None:
    rows = random_joints(checker, 400, seed=4)
    rows = rows[checker.free_rows(rows, 0.01)][:60] if checker.dof > 5 else rows[checker.free_rows(rows, 0.002)][:60]
    margin = 0.002
    fractions, free_until, _ = checker.first_hit_rows(rows[:-1], rows[1:], margin=margin, threads=2)
    assert np.isinf(fractions).any()
    for start, goal, until in zip(rows[:-1], rows[1:], free_until, strict=True):
        samples = start + np.linspace(0.0, until, 400)[:, None] * (goal - start)
        assert checker.free_rows(samples, margin - 0.001).all()


def test_however_short_a_motion_its_end_is_looked_at(env: Env, checker: CollisionChecker) -> None:
    margin, home = 0.001, np.array(next(iter(env.robots.values())).arm.home)
    seen = 0
    for goal in random_joints(checker, 60, seed=6):
        hit = checker.first_hit(home, goal, margin=margin)
        if hit is None:
            continue
        way, free = goal - home, hit.free_until
        for length in 10.0 ** np.arange(-5.0, -1.5, 0.25):  # shares of the way, from a place that is free
            end = home + min(free + length, 1.0) * way
            if not checker.is_free(end, margin):
                assert checker.first_hit(home + free * way, end, margin=margin) is not None
                seen += 1
    assert seen > 40


def test_a_thin_wall_in_mid_path_is_never_missed() -> None:
    """A wall of 1 mm stands where neither end of the motion is near it."""
    with rcs.make("Free", robot="fr3") as env:
        env.reset(seed=0)
        robot = env.robots["fr3"]
        from rcs.sim.scene import Scene  # a scene of its own, to put the wall into

        scene = Scene.empty()
        scene.add_robot(robot)
        for x in np.linspace(-0.02, 0.02, 9):
            scene.spec.worldbody.add_geom(
                name=f"wall {x:.3f}", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.3, 0.0005, 0.6], pos=[0.6, x, 0.4]
            )
        model = scene.compile()
        ids = [model.joint(robot.prefix + name).id for name in robot.arm.joints]
        checker = CollisionChecker(model, [ids])
        home = np.array(robot.arm.home)
        start, goal = home.copy(), home.copy()
        start[0], goal[0] = -1.2, 1.2
        assert checker.is_free(start, 0.01)
        assert checker.is_free(goal, 0.01)
        rng = np.random.default_rng(0)
        starts = start + rng.normal(0.0, 0.1, (200, 7))
        goals = goal + rng.normal(0.0, 0.1, (200, 7))
        fractions, _, geoms = checker.first_hit_rows(starts, goals)
        assert np.isfinite(fractions).all()
        assert all("wall" in checker.describe(min(pair)) or "wall" in checker.describe(max(pair)) for pair in geoms)


def test_a_motion_into_the_table_names_it(env: Env, checker: CollisionChecker) -> None:
    rows = random_joints(checker, 400, seed=5)
    home = np.array(next(iter(env.robots.values())).arm.home)
    names = set()
    for q in rows:
        hit = checker.first_hit(home, q)
        if hit is not None:
            names |= {checker.describe(geom) for geom in hit.geoms}
            assert 0.0 <= hit.free_until <= hit.fraction <= 1.0
            assert hit.distance < 0.0
    assert "geom 'table top' of body 'table'" in names


def test_without_geometry_of_a_robot_there_is_an_error(env: Env) -> None:
    with pytest.raises(InvalidSetup, match="no geometry of the robots takes part"):
        CollisionChecker(env.simulation.world.model, [])


def test_rows_of_a_wrong_width_are_refused(checker: CollisionChecker) -> None:
    with pytest.raises(InvalidSetup, match=r"\(N, "):
        checker.free_rows(np.zeros((3, checker.dof + 1)))
    with pytest.raises(InvalidSetup, match="joints given"):
        checker.is_free(np.zeros(checker.dof + 1))
