"""The state that a world holds, and that is read out of it."""

from __future__ import annotations

import gc
import sys
from copy import copy as copy_of
from pathlib import Path

import mujoco
import numpy as np
import pytest

from rcs._core import StepEnd
from rcs.errors import InvalidSetup
from rcs.sim import RobotPlacement, World
from rcs.sim.loads import SimLoads
from rcs.sim.robot import SimRobot
from rcs.spatial import Pose


def test_a_world_works_on_the_users_own_model_and_data(cart: mujoco.MjModel) -> None:
    data = mujoco.MjData(cart)
    world = World(cart, data=data, frequency=50.0)
    assert world.model is cart
    assert world.data is data
    world.ctrl[0] = 0.5
    assert data.ctrl[0] == 0.5
    data.qpos[0] = 0.25
    assert world.qpos[0] == 0.25
    world.advance()
    assert data.time == pytest.approx(0.02)
    assert np.shares_memory(world.qpos, data.qpos)


def test_stepping_a_world_is_stepping_mujoco(cart: mujoco.MjModel) -> None:
    data, mine = mujoco.MjData(cart), mujoco.MjData(cart)
    world = World(cart, data=data, frequency=50.0)
    data.ctrl[0] = mine.ctrl[0] = 0.7
    for _ in range(10):
        world.advance()
        mujoco.mj_step(cart, mine, nstep=10)
        assert data.qpos[0] == mine.qpos[0]
        assert data.qvel[0] == mine.qvel[0]


@pytest.mark.parametrize("threads", [1, 2])
def test_every_copy_has_the_bits_of_a_world_of_one(
    lab: mujoco.MjModel, placement: RobotPlacement, threads: int
) -> None:
    rng = np.random.default_rng(0)
    targets = np.array(placement.arm.home) + rng.uniform(-0.3, 0.3, (6, 3, 7))
    batch = SimRobot(World(lab, copies=3, threads=threads), placement)
    batch.go_home()
    singles = [SimRobot(World(lab), placement) for _ in range(3)]
    for single in singles:
        single.go_home()
    for step in range(6):
        batch.command_joints(targets[step])
        batch.command_opening(np.full((3, 1), step % 2))
        batch.world.advance()
        for copy, single in enumerate(singles):
            single.command_joints(targets[step, copy])
            single.command_opening(np.array([step % 2]))
            single.world.advance()
            for name in ("joints", "joint_velocities", "tcp_tquat", "tcp_xyzrpy", "opening"):
                np.testing.assert_array_equal(getattr(batch, name)[copy], getattr(single, name), err_msg=name)
            np.testing.assert_array_equal(batch.world.core.get_state(copy), single.world.core.get_state(0))


@pytest.mark.parametrize("copies", [None, 2])
def test_a_state_that_is_set_again_goes_on_with_the_same_bits(
    lab: mujoco.MjModel, placement: RobotPlacement, copies: int | None
) -> None:
    robot = SimRobot(World(lab, copies=copies), placement)
    robot.go_home()
    copy = robot.world.copies - 1
    robot.command_joints(robot.joints + 0.2)
    for _ in range(3):
        robot.world.advance()
    state = robot.world.core.get_state(copy)
    steps = robot.world.core.steps[copy]

    def go_on() -> list[np.ndarray]:
        seen = []
        for _ in range(5):
            robot.world.advance()
            seen.append(robot.world.core.get_state(copy))
        return seen

    first = go_on()
    robot.world.core.set_state(state, copy)
    np.testing.assert_array_equal(robot.world.core.get_state(copy), state)
    robot.world.core.steps[copy] = steps
    np.testing.assert_array_equal(go_on(), first)


def test_states_of_a_batch_are_live_rows(cart: mujoco.MjModel) -> None:
    world = World(cart, copies=3)
    states = world.states()
    assert states.shape == (3, world.core.state_size)
    world.qpos[1, 0] = 0.3
    assert 0.3 in states[1]
    np.testing.assert_array_equal(states[1], world.core.get_state(1))
    single = World(cart)
    assert single.states().shape == (single.core.state_size,)
    with pytest.raises(AttributeError, match="get_state"):
        _ = single.core.states


@pytest.mark.parametrize("copies", [None, 3])
def test_a_state_of_the_wrong_size_or_copy_is_refused(cart: mujoco.MjModel, copies: int | None) -> None:
    core = World(cart, copies=copies).core
    state = core.get_state(0)
    for bad in (state[:-1], np.append(state, 0.0), np.zeros(0)):
        with pytest.raises(InvalidSetup):
            core.set_state(bad, 0)
    for copy in (-1, 3):
        with pytest.raises(InvalidSetup):
            core.get_state(copy)
        with pytest.raises(InvalidSetup):
            core.set_state(state, copy)


@pytest.mark.parametrize("call", ["advance", "reset", "refresh"])
def test_a_copy_that_is_not_there_is_refused(cart: mujoco.MjModel, call: str) -> None:
    world = World(cart, copies=3)
    for copy in (-1, 3):
        with pytest.raises(InvalidSetup, match=f"no copy {copy}"):
            getattr(world, call)(np.array([0, copy], np.int32))
    np.testing.assert_array_equal(world.core.steps, 0)


@pytest.mark.parametrize("call", ["advance", "reset", "refresh"])
def test_an_empty_selection_of_copies_is_none_and_not_all(cart: mujoco.MjModel, call: str) -> None:
    world = World(cart, copies=2)
    world.advance()
    getattr(world, call)(np.array([], np.int32))
    np.testing.assert_array_equal(world.core.steps, 1)


@pytest.mark.parametrize("copies", [None, 2])
def test_refresh_is_idempotent_and_moves_nothing(cart: mujoco.MjModel, copies: int | None) -> None:
    world = World(cart, copies=copies)
    pose = world.core.read_pose(cart.site("front").id, 0)
    world.qpos[..., 0] = 0.4
    before = [world.core.get_state(copy) for copy in range(world.copies)]
    world.refresh()
    once = world.core.poses.copy()
    world.refresh()
    np.testing.assert_array_equal(world.core.poses, once)
    np.testing.assert_allclose(once[..., pose, :3], np.broadcast_to([0.5, 0.0, 0.0], (*world.leading, 3)), atol=1e-12)
    np.testing.assert_array_equal([world.core.get_state(copy) for copy in range(world.copies)], before)


def test_poses_are_those_of_mujoco_in_the_frame_of_the_body(robot: SimRobot) -> None:
    robot.command_joints(robot.joints + np.array([0.1, 0.2, -0.1, 0.3, 0.1, -0.2, 0.3]))
    for _ in range(10):
        robot.world.advance()
    data = robot.world.data
    assert data is not None
    site, base = data.site(robot.placement.tcp_site), data.body(robot.placement.base_body)
    world_of = [np.eye(4), np.eye(4)]
    for matrix, rotation, translation in zip(world_of, (base.xmat, site.xmat), (base.xpos, site.xpos), strict=True):
        matrix[:3, :3], matrix[:3, 3] = rotation.reshape(3, 3), translation
    expected = Pose.from_matrix(np.linalg.inv(world_of[0]) @ world_of[1])
    np.testing.assert_allclose(robot.tcp_tquat, expected.tquat, atol=1e-9)
    np.testing.assert_allclose(robot.tcp_xyzrpy, expected.xyzrpy, atol=1e-9)


@pytest.mark.parametrize("copies", [None, 3])
def test_an_array_of_readouts_stays_valid_when_readouts_are_added(cart: mujoco.MjModel, copies: int | None) -> None:
    world = World(cart, copies=copies)
    core = world.core
    core.read_pose(cart.site("front").id, 0)
    core.read_force(np.ones(2, np.uint8), np.ones(2, np.uint8))
    core.read_opening([0], 0.0, 1.0)
    world.refresh()
    views = [core.poses, core.xyzrpy, core.forces, core.openings]
    kept = [view.copy() for view in views]
    for _ in range(20):
        core.read_pose(0, 0)
        core.read_body_pose(1, 0)
        core.read_force(np.ones(2, np.uint8), np.zeros(2, np.uint8))
        core.read_opening([0], 0.0, 2.0)
    world.qpos[..., 0] = 0.5
    world.refresh()
    for view, before in zip(views, kept, strict=True):
        np.testing.assert_array_equal(view, before)
    assert core.poses.shape == (*world.leading, 41, 7)
    np.testing.assert_allclose(core.openings[..., :2], np.broadcast_to([0.5, 0.25], (*world.leading, 2)))
    for joints, opened in (([], 1.0), ([0], 0.0), ([7], 1.0)):
        with pytest.raises(InvalidSetup, match="opening readout"):
            core.read_opening(joints, 0.0, opened)


@pytest.mark.parametrize("copies", [None, 2])
def test_what_is_read_out_late_is_right_and_freezes_nothing(
    lab: mujoco.MjModel, placement: RobotPlacement, copies: int | None
) -> None:
    world, other = (World(lab, copies=copies, threads=1) for _ in range(2))
    robot = SimRobot(world, placement)
    robot.go_home()
    world.refresh()
    home = robot.tcp_tquat
    late = world.read_pose("fr3/link7", placement.base_body)
    np.testing.assert_array_equal(robot.tcp_tquat, home)
    loads, twin = SimLoads(robot), SimRobot(world, placement)
    np.testing.assert_array_equal([twin.opening, robot.opening], 1.0)
    robot.command_joints(robot.joints + 0.2)
    for _ in range(10):
        world.advance()
    assert np.abs(robot.tcp_tquat - home).max() > 0.01
    np.testing.assert_array_equal(twin.tcp_tquat, robot.tcp_tquat)
    assert loads.joint_torques.shape == (*world.leading, 7) and loads.joint_torques.any()
    early = other.read_pose("fr3/link7", placement.base_body)
    other.qpos[...] = world.qpos
    other.refresh()
    np.testing.assert_allclose(world.poses[..., late, :], other.poses[..., early, :], atol=1e-12)


@pytest.mark.parametrize("copies", [None, 3])
def test_a_state_that_is_not_finite_ends_the_step_as_failed_and_others_go_on(
    cart: mujoco.MjModel, copies: int | None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log there
    world = World(cart, copies=copies, threads=2)
    world.qvel[(-1, 0) if copies else 0] = np.nan
    world.advance()
    np.testing.assert_array_equal(world.core.ends, [StepEnd.period.value] * (world.copies - 1) + [StepEnd.failed.value])
    world.reset()
    world.advance()
    np.testing.assert_array_equal(world.core.ends, StepEnd.period.value)


def test_reset_returns_to_the_state_that_was_kept(cart: mujoco.MjModel) -> None:
    world = World(cart, copies=2)
    world.qpos[0, 0] = 0.2
    world.core.keep_initial_state(0)
    world.ctrl[:] = 0.9
    world.advance()
    world.reset()
    np.testing.assert_array_equal(world.qpos[:, 0], 0.2)
    np.testing.assert_array_equal(world.ctrl, 0.0)
    np.testing.assert_array_equal(world.time, 0.0)


def test_copies_may_have_values_of_their_own_in_fields_of_the_model(cart: mujoco.MjModel) -> None:
    world = World(cart, copies=3, threads=2, frequency=50.0)
    gains = world.core.expand("actuator_gainprm")
    assert gains.shape == (3, cart.actuator_gainprm.size)
    gains[:, 0] = [50.0, 100.0, 200.0]
    world.ctrl[:, 0] = 0.5
    world.advance()
    assert (np.diff(world.qpos[:, 0]) > 0).all()
    assert cart.actuator_gainprm[0, 0] == 100.0
    plain = World(cart, frequency=50.0)
    plain.ctrl[0] = 0.5
    plain.advance()
    assert world.qpos[1, 0] == plain.qpos[0]


def test_only_numbers_of_a_batch_can_differ_between_copies(cart: mujoco.MjModel) -> None:
    with pytest.raises(ValueError, match="only a batch"):
        World(cart).core.expand("body_mass")
    for field in ("no_such_field", "tex_data", "names"):
        with pytest.raises(ValueError, match="can differ between copies"):
            World(cart, copies=2).core.expand(field)


@pytest.mark.parametrize("field", ["body_mass", "geom_size", "geom_rgba", "geom_matid", "light_diffuse", "dof_damping"])
def test_a_field_starts_with_the_models_values_and_keeps_its_type(cart: mujoco.MjModel, field: str) -> None:
    nominal = getattr(cart, field).copy()
    world = World(cart, copies=2)
    np.testing.assert_array_equal(world.field(field), [nominal, nominal])
    assert world.core.expanded(field) is None
    assert not world.core.is_varied
    values = world.vary(field)
    assert world.core.is_varied
    assert values.shape == (2, *nominal.shape)
    assert values.dtype == nominal.dtype
    np.testing.assert_array_equal(values, [nominal, nominal])
    values[1] += 1
    np.testing.assert_array_equal(world.field(field), [nominal, nominal + 1])
    np.testing.assert_array_equal(getattr(cart, field), nominal)


def test_a_field_of_a_world_of_one_is_the_models_own(cart: mujoco.MjModel) -> None:
    model = copy_of(cart)
    world = World(model)
    world.vary("body_mass")[1] = 3.0
    assert model.body_mass[1] == 3.0
    assert world.field("body_mass")[1] == 3.0


@pytest.mark.parametrize("copies", [None, 2])
def test_nominal_values_are_those_before_the_first_change(cart: mujoco.MjModel, copies: int | None) -> None:
    before = cart.body_mass.copy()
    world = World(copy_of(cart), copies=copies)
    np.testing.assert_array_equal(world.nominal("body_mass"), before)
    world.vary("body_mass")[..., 1] = 3.0
    world.vary("body_mass")[..., 1] = 4.0
    np.testing.assert_array_equal(world.nominal("body_mass"), before)
    assert world.varied == ["body_mass"]


def test_constants_follow_the_masses_of_each_copy_and_leave_the_state_alone(cart: mujoco.MjModel) -> None:
    world = World(cart, copies=3, threads=2)
    world.qpos[:] = 0.3
    before = world.states().copy()
    world.vary("body_mass")[:, 1] = [1.0, 2.0, 4.0]
    world.update_constants(np.array([1, 2], np.int32))
    np.testing.assert_allclose(world.field("dof_invweight0")[:, 0], [1.0, 0.5, 0.25])
    np.testing.assert_array_equal(world.states(), before)
    for mass, invweight in zip([1.0, 2.0, 4.0], world.field("dof_invweight0"), strict=True):
        single = World(copy_of(cart))
        single.vary("body_mass")[1] = mass
        single.update_constants()
        np.testing.assert_array_equal(single.field("dof_invweight0"), invweight)
    world.update_constants()


def test_a_component_that_the_model_lacks_is_refused(cart: mujoco.MjModel) -> None:
    world = World(cart)
    with pytest.raises((ValueError, InvalidSetup)):
        world.core.component(mujoco.mjtState.mjSTATE_WARMSTART.value)


def test_a_readout_of_what_is_not_in_the_model_is_refused(cart: mujoco.MjModel) -> None:
    core = World(cart).core
    for call in (lambda: core.read_pose(1, 0), lambda: core.read_pose(0, 3), lambda: core.read_body_pose(3, 0)):
        with pytest.raises(InvalidSetup, match="not in the model"):
            call()
    with pytest.raises(InvalidSetup, match="one flag per geom"):
        core.read_force(np.ones(1, np.uint8), np.ones(2, np.uint8))


def test_arrays_and_devices_keep_the_data_they_point_to_alive(lab: mujoco.MjModel, placement: RobotPlacement) -> None:
    data = mujoco.MjData(lab)
    before = sys.getrefcount(data)
    qpos = World(lab, data=data).qpos
    gc.collect()
    assert sys.getrefcount(data) > before
    del qpos
    gc.collect()
    assert sys.getrefcount(data) == before
    arm = SimRobot(World(lab, data=data), placement).arm()
    gc.collect()
    assert sys.getrefcount(data) > before
    arm.open()
    assert arm.state().joints.shape == (7,)


def test_flags_name_geoms_and_subtrees(lab: mujoco.MjModel, placement: RobotPlacement) -> None:
    world = World(lab)
    pads = world.geom_flags(placement.gripper_prefix + name for name in ("left_pad", "right_pad"))
    assert pads.sum() == 2
    robot = world.subtree_flags(placement.base_body)
    hand = world.subtree_flags(placement.gripper_prefix + "hand")
    assert (robot >= hand).all()
    assert (hand >= pads).all()
    assert not robot[lab.geom("floor").id]
    with pytest.raises(KeyError):
        world.geom_flags(["no such geom"])
