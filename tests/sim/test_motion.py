"""Arms move to their targets within limits of velocity, acceleration and jerk, and follow streams of targets."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs._core import Motion, MotionLimits, StepEnd
from rcs.errors import InvalidSetup
from rcs.robots.description import ArmDescription
from rcs.robots.fr3 import FR3
from rcs.robots.so101 import SO101
from rcs.robots.ur5e import UR5E
from rcs.robots.xarm7 import XARM7
from rcs.sim import RobotPlacement, Scene, World
from rcs.sim.robot import SimRobot

ARMS = {arm.name: arm for arm in (FR3, UR5E, XARM7, SO101)}


class Watched:
    """An arm alone, without contacts, and what it does in every physics step."""

    def __init__(self, arm: ArmDescription = FR3, **options: Any) -> None:
        placement = RobotPlacement(name="arm", arm=arm)
        scene = Scene.empty()
        scene.add_robot(placement)
        model = scene.compile()
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.world = World(model, **options)
        self.robot = SimRobot(self.world, placement)
        if options.get("stepping") == "sync":
            self.robot.wait_for_arrival()
        self.robot.go_home()
        self.world.refresh()
        self.rows: list[NDArray[np.float64]] = []
        if self.world.data is not None:
            self.world.on_period(self._note, model.opt.timestep)

    def _note(self, view: Any) -> None:
        self.rows.append(self.robot.motion.state(view))

    def go(self, joints: NDArray[np.float64], steps: int = 1) -> None:
        for _ in range(steps):
            self.robot.command_joints(joints)
            self.world.advance()

    def led(self) -> NDArray[np.float64]:
        """Position, velocity and acceleration that the joints were led to, (3, physics steps, dof)."""
        return np.stack(self.rows, axis=1)


def random_targets(arm: ArmDescription, number: int) -> NDArray[np.float64]:
    draws = np.random.default_rng(0)
    near = np.array(arm.home) + draws.uniform(-0.1, 0.1, (number // 2, arm.dof))
    far = draws.uniform(arm.joint_lower, arm.joint_upper, (number - number // 2, arm.dof))
    return np.concatenate([near, far])


@pytest.mark.parametrize("stepping", ["async", "sync"])
@pytest.mark.parametrize("name", ARMS)
def test_no_limit_is_exceeded_whatever_the_targets(name: str, stepping: Any) -> None:
    arm = ARMS[name]
    watched = Watched(arm, stepping=stepping)
    for target in random_targets(arm, 60 if stepping == "async" else 12):
        watched.go(target)
    position, velocity, acceleration = watched.led()
    assert np.all(np.abs(velocity) <= arm.velocity_limit)
    assert np.all(np.abs(acceleration) <= arm.acceleration_limit)
    step = watched.world.model.opt.timestep
    assert np.all(np.abs(np.diff(acceleration, axis=0)) <= 1.0001 * step * np.array(arm.jerk_limit))
    # Velocity and acceleration are those of the position: the trapezoidal rule is that good.
    np.testing.assert_allclose(np.diff(position, axis=0), step * (velocity[1:] + velocity[:-1]) / 2, atol=2e-5)


@pytest.mark.parametrize("name", ARMS)
def test_a_joint_does_not_pass_a_far_target_nor_the_range(name: str) -> None:
    arm = ARMS[name]
    watched = Watched(arm)
    target = np.array(arm.joint_upper) + 0.5
    watched.go(target, 150)
    position, velocity, _ = watched.led()
    assert np.all(position <= np.array(arm.joint_upper) + 1e-9)
    assert np.all(velocity >= -1e-9)
    np.testing.assert_allclose(position[-1], arm.joint_upper, atol=1e-9)
    np.testing.assert_allclose(watched.robot.joints, arm.joint_upper, atol=1e-3)


def test_the_way_to_a_far_target_is_straight() -> None:
    watched = Watched(stepping="sync")
    home = np.array(FR3.home)
    way = np.array([0.8, 0.4, -0.3, 0.2, 0.5, -0.6, 1.0])
    watched.go(home + way)
    offsets = watched.led()[0] - home
    across = offsets - np.outer(offsets @ way, way) / (way @ way)
    np.testing.assert_allclose(across, 0.0, atol=1e-9)


def test_the_servos_are_where_the_joints_are_led() -> None:
    watched = Watched()
    errors = []
    for k in range(60):
        watched.go(np.array(FR3.home) + 0.3 * np.sin(k / 10))
        errors.append(np.abs(watched.robot.joints - watched.led()[0, -1]).max())
    assert max(errors) < 3e-3


def test_a_synchronous_step_ends_at_rest_at_the_target_and_lasts_a_period_at_least() -> None:
    watched = Watched(stepping="sync")
    target = np.array(FR3.home) + 0.5
    watched.go(target)
    assert watched.world.ends == [StepEnd.converged]
    np.testing.assert_allclose(watched.robot.joints, target, atol=1e-3)
    assert np.abs(watched.robot.joint_velocities).max() < 1e-2
    before = watched.world.time.item()
    watched.go(target)
    assert watched.world.time.item() - before == pytest.approx(1 / 30, abs=2e-3)


@pytest.mark.parametrize("name", ARMS)
def test_a_preview_of_a_step_and_of_braking_after_it_is_what_happens(name: str) -> None:
    arm, draws = ARMS[name], np.random.default_rng(1)
    watched = Watched(arm)
    timestep = watched.world.model.opt.timestep
    for _ in range(12):
        watched.robot.go_home()
        watched.world.refresh()
        target = draws.uniform(arm.joint_lower, arm.joint_upper)
        watched.go(target, int(draws.integers(3, 25)))
        way = watched.world.core.preview(watched.robot.motion, target, 0, 0.01)
        watched.rows.clear()
        watched.go(target)
        duration = len(watched.rows) * timestep
        watched.robot.stop()
        for _ in range(40):
            watched.world.advance()
        pace = duration / np.ceil(duration / 0.01 - 1e-9)
        told = pace * np.arange(len(way))
        happened = timestep * np.arange(1, len(watched.rows) + 1)
        led = watched.led()[0]
        for joint in range(arm.dof):
            there = np.interp(told[1:], happened, led[:, joint])
            np.testing.assert_allclose(there, way[1:, joint], atol=1e-3)


@pytest.mark.parametrize("name", ARMS)
def test_a_far_motion_of_the_whole_arm_asks_for_no_more_torque_than_there_is(name: str) -> None:
    arm = ARMS[name]
    watched, draws = Watched(arm, stepping="sync"), np.random.default_rng(3)
    behind: list[float] = []
    watched.world.on_period(
        lambda view: behind.append(np.abs(watched.robot.joints - watched.robot.motion.state(view)[0]).max()),
        watched.world.model.opt.timestep,
    )
    for _ in range(8):
        way = draws.uniform(0.7, 1.8, arm.dof) * draws.choice([-1, 1], arm.dof)
        watched.go(np.clip(np.array(arm.home) + way, arm.joint_lower, arm.joint_upper))
        assert watched.world.ends == [StepEnd.converged]
    assert max(behind) < 0.02


def test_a_far_synchronous_step_takes_the_time_it_needs() -> None:
    watched = Watched(UR5E, stepping="sync", max_substeps=100)
    target = np.array(UR5E.home)
    target[0] += 5.0
    watched.go(target)  # 2.1 s, of which 0.2 s would be the limit
    assert watched.world.ends == [StepEnd.converged]


@pytest.mark.parametrize("name", ARMS)
def test_a_stream_is_followed_without_lag_and_hardly_overshot_when_it_ends(name: str) -> None:
    arm = ARMS[name]
    watched = Watched(arm, frequency=50.0)
    middle = (np.array(arm.joint_lower) + np.array(arm.joint_upper)) / 2
    speed = 0.15 * np.array(arm.velocity_limit) * np.where(np.array(arm.home) > middle, -1.0, 1.0)
    target = np.array(arm.home)
    errors = []
    for k in range(50):
        target = target + speed / 50 * min(1.0, k / 25)
        watched.go(target)
        errors.append(np.abs(watched.led()[0, -1] - target).max())
    assert max(errors[40:]) < 3e-3
    velocities = watched.led()[1, -40:]
    np.testing.assert_allclose(velocities, np.broadcast_to(speed, velocities.shape), rtol=0.05)
    watched.rows.clear()
    watched.go(target, 50)
    assert (np.sign(speed) * (watched.led()[0] - target)).max() < 0.03
    np.testing.assert_allclose(watched.led()[0, -1], target, atol=1e-9)


def test_noise_of_a_stream_is_not_chased() -> None:
    draws = np.random.default_rng(0)
    rms = []
    for noise in (0.0, 1e-3):
        watched = Watched()
        for k in range(90):
            watched.go(np.array(FR3.home) + 0.2 * (1 - np.cos(k / 15)) + draws.normal(0.0, noise, 7))
        rms.append(np.sqrt(np.mean(watched.led()[2] ** 2)))
    # Meeting every target exactly would take four times the noise over the period squared, 5 rad/s^2.
    assert rms[1] < rms[0] + 3.0


def test_a_restored_state_goes_on_with_the_same_bits() -> None:
    targets = random_targets(FR3, 20)
    one = Watched()
    for target in targets[:10]:
        one.go(target)
    state = one.world.states().copy()
    for target in targets[10:]:
        one.go(target)
    other = Watched()
    other.go(targets[3], 3)
    other.world.core.set_state(state)
    other.world.core.steps[:] = 10
    for target in targets[10:]:
        other.go(target)
    np.testing.assert_array_equal(one.world.states(), other.world.states())


@pytest.mark.parametrize("threads", [1, 3])
def test_copies_move_as_one_alone(threads: int) -> None:
    targets = random_targets(FR3, 24).reshape(6, 4, 7)
    many = Watched(copies=4, threads=threads)
    alone = [Watched() for _ in range(4)]
    for row in targets:
        many.go(row)
        for copy, one in enumerate(alone):
            one.go(row[copy])
    np.testing.assert_array_equal(many.world.states(), [one.world.states() for one in alone])


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_that_is_told_to_stop_brakes_on_a_straight_line_within_its_limits_and_stays(name: str) -> None:
    arm = ARMS[name]
    watched = Watched(arm)
    way = np.where(np.array(arm.home) > (np.array(arm.joint_lower) + np.array(arm.joint_upper)) / 2, -1.0, 1.0)
    watched.go(np.array(arm.home) + way, 8)
    start = watched.led()[:2, -1]
    assert np.abs(start[1]).max() > 0.5
    watched.rows.clear()
    for _ in range(30):
        watched.robot.stop()  # again and again changes nothing
        watched.world.advance()
    position, velocity, acceleration = watched.led()
    assert np.all(np.abs(acceleration) <= arm.acceleration_limit)
    assert np.all(velocity * np.sign(start[1]) >= -1e-9)
    np.testing.assert_array_equal(velocity[-1], 0.0)
    along = start[1] / np.linalg.norm(start[1])
    across = position - start[0] - np.outer((position - start[0]) @ along, along)
    np.testing.assert_allclose(across, 0.0, atol=2e-3)
    speed, brake = np.abs(start[1]), np.array(arm.acceleration_limit)
    longest = (speed / brake).max() + 2 * (brake / arm.jerk_limit).max()
    assert np.all(np.abs(position[-1] - start[0]) <= speed * longest / 2 * 1.3)
    np.testing.assert_allclose(watched.robot.joints, watched.robot._memory[: arm.dof], atol=2e-3)


def test_a_command_after_an_order_to_stop_counts() -> None:
    watched = Watched()
    watched.robot.stop()
    watched.go(np.array(FR3.home) + 0.1, 30)
    np.testing.assert_allclose(watched.robot.joints, np.array(FR3.home) + 0.1, atol=1e-3)


def test_an_arm_that_is_pushed_away_and_told_to_stop_stays_where_it_was_pushed_to() -> None:
    watched = Watched()
    watched.world.qpos[...] += 0.1
    watched.robot.stop()
    for _ in range(10):
        watched.world.advance()
    np.testing.assert_allclose(watched.robot.joints, np.array(FR3.home) + 0.1, atol=5e-3)


def limits(dof: int = 7, **changed: list[float]) -> MotionLimits:
    values = {"lower": [-1.0] * dof, "upper": [1.0] * dof, "velocity": [1.0] * dof}
    return MotionLimits(**{**values, "acceleration": [1.0] * dof, "jerk": [1.0] * dof, **changed})


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"velocity": [1.0] * 6}, "one value per joint"),
        ({"velocity": [0.0] * 7}, "positive"),
        ({"jerk": [np.nan] * 7}, "positive"),
        ({"lower": [1.0] * 7}, "below"),
    ],
)
def test_limits_that_are_none_are_refused(changed: dict[str, list[float]], words: str) -> None:
    with pytest.raises(InvalidSetup, match=words):
        Motion(list(range(7)), list(range(7)), 0, limits(**changed), 1)


def test_motions_that_do_not_fit_the_world_are_refused() -> None:
    watched = Watched()
    core, ids = watched.world.core, watched.robot.layout
    same = Motion(ids.joint_ids, ids.actuator_ids, ids.motion, limits(), 1)
    assert core.add_motion(same) is watched.robot.motion
    for address, copies in ((ids.motion + 1, 1), (-1, 1)):
        with pytest.raises(InvalidSetup, match="user data"):
            core.add_motion(Motion(ids.joint_ids, ids.actuator_ids, address, limits(), copies))
    with pytest.raises(InvalidSetup, match=r"user data .* overlap"):
        core.add_motion(Motion(ids.joint_ids[:3], ids.actuator_ids[:3], ids.motion + 5, limits(3), 1))
    with pytest.raises(InvalidSetup, match="copies"):
        Motion(ids.joint_ids, ids.actuator_ids, ids.motion, limits(), 0)
    with pytest.raises(InvalidSetup, match="each joint needs its actuator"):
        Motion(ids.joint_ids, ids.actuator_ids[1:], ids.motion, limits(), 1)
    many = Watched(copies=2)
    with pytest.raises(InvalidSetup, match="is for 1 copies"):
        many.world.core.add_motion(same)
