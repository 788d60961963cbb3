"""The contract of arms, as tests."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.devices import Arm, CommandKind
from rcs.errors import InvalidAction
from rcs.spatial import Pose
from rcs.testing.motion_contract import MotionContract


class ArmContract(MotionContract[Arm]):
    """Checks an arm. Moves it by `distance` at every joint, several times: clear its surroundings first."""

    distance: float = 0.1
    """How far every joint moves [rad], towards the middle of its limits."""
    tolerance: float = 2e-3
    """How close to its target an arm must come, and how far one that stands still may move [rad]."""
    speed_margin: float = 1.05
    """By which factor a measured speed may exceed the limit: measurements are noisy."""
    still: float = 0.02
    """Measured speed of a joint that stands still, at most [rad/s]."""

    def position(self, device: Arm) -> NDArray[np.float64]:
        """Return the joints [rad]."""
        return device.state().joints

    def command(self, device: Arm, target: Any, valid_for: float = math.inf) -> None:
        """Send joints."""
        device.command_joints(target, valid_for)

    def target_of(self, device: Arm) -> NDArray[np.float64]:
        """Return a target that is `distance` away from the present joints, towards the middle of the limits."""
        joints = self.position(device)
        middle = (device.limits.joint_lower + device.limits.joint_upper) / 2
        return joints + np.where(joints < middle, self.distance, -self.distance)

    def least_time(self, device: Arm, target: Any) -> float:
        """Return how long the joint that has the longest way takes at its largest velocity [s]."""
        way = np.abs(np.asarray(target) - self.position(device)) - self.tolerance
        return float((way / device.limits.joint_velocity).max())

    def bad_targets(self, device: Arm) -> list[NDArray[np.float64]]:
        """Return targets of a wrong size, not finite and out of limits."""
        joints, limits = self.position(device), device.limits
        values = (math.nan, math.inf, -math.inf, limits.joint_upper[0] + 0.01, limits.joint_lower[0] - 0.01)
        bad = [np.array([value, *joints[1:]]) for value in values]
        bad += [np.where(np.arange(device.dof) == i, math.nan, joints) for i in range(device.dof)]
        return [np.zeros(0), joints[1:], np.append(joints, 0.0), *bad]

    def look_while_moving(self, device: Arm) -> None:
        """Check that no joint is faster than it may."""
        limit = device.limits.joint_velocity * self.speed_margin
        assert (np.abs(device.state().joint_velocities) <= limit).all()

    def test_a_state_has_a_finite_value_for_every_joint(self) -> None:
        """Arrays that the arm does not measure are empty; measurements are copies."""
        with self.open_device() as arm:
            state = arm.state()
            assert state.joints.shape == state.joint_velocities.shape == (arm.dof,)
            for values in (state.joints, state.joint_velocities, state.commanded_joints, state.efforts, state.wrench):
                assert np.isfinite(values).all()
            assert state.commanded_joints.shape in ((arm.dof,), (0,))
            assert state.efforts.shape in ((arm.dof,), (0,))
            assert state.wrench.shape in ((6,), (0,))
            state.joints[:] = 9.0
            assert (arm.state().joints < 9.0).all()

    def test_limits_make_sense_and_the_arm_is_within_them(self) -> None:
        """One of each per joint; those that are not known are empty. They are copies."""
        with self.open_device() as arm:
            limits = arm.limits
            assert arm.dof >= 1
            for values in (limits.joint_lower, limits.joint_upper, limits.joint_velocity):
                assert values.shape == (arm.dof,)
                assert np.isfinite(values).all()
            assert (limits.joint_lower < limits.joint_upper).all()
            for values in (limits.joint_velocity, limits.joint_acceleration, limits.joint_jerk, limits.joint_effort):
                assert values.shape in ((arm.dof,), (0,))
                assert (values > 0).all()
            joints = self.position(arm)
            assert (joints >= limits.joint_lower - self.tolerance).all()
            assert (joints <= limits.joint_upper + self.tolerance).all()
            limits.joint_upper[:] = 9.0
            assert (arm.limits.joint_upper < 9.0).all()

    def test_an_arm_that_stands_still_measures_no_speed(self) -> None:
        """Before the first command, and at a target; the controller wants it where it is."""
        with self.open_device() as arm:
            assert (np.abs(arm.state().joint_velocities) <= self.still).all()
            self.begin(arm, self.target_of(arm))
            self.move(arm)
            self.advance(self.stopping_time)
            state = arm.state()
            assert (np.abs(state.joint_velocities) <= self.still).all()
            if state.commanded_joints.size:
                np.testing.assert_allclose(state.commanded_joints, state.joints, rtol=0.0, atol=self.tolerance)

    def test_measured_speeds_point_where_the_arm_goes(self) -> None:
        """Seen in the middle of its way."""
        with self.open_device() as arm:
            start, target = self.position(arm), self.target_of(arm)
            self.begin(arm, target)
            state, share = arm.state(), 0.0
            for _ in range(math.ceil(self.time_limit / self.tick)):
                state = arm.state()
                share = (state.joints - start) @ (target - start) / ((target - start) @ (target - start))
                if share > 0.3:
                    break
                self.advance(self.tick)
            self.stop(lambda: None)
            if share > 0.8 and self.may_have_arrived:
                pytest.skip("the machine is too busy to see the arm on its way")
            assert 0.3 < share <= 0.8
            assert state.joint_velocities @ (target - start) > 0.0

    def test_a_far_first_target_is_refused_or_approached_slowly_enough(self) -> None:
        """Never jumped to: the arm keeps to its speeds, and stops short of it when its time is over."""
        with self.open_device() as arm:
            joints, limits = self.position(arm), arm.limits
            middle = (limits.joint_lower + limits.joint_upper) / 2
            far = np.where(joints < middle, limits.joint_upper, limits.joint_lower)
            began = time.monotonic()
            try:
                self.command(arm, far, 3 * self.tick)
            except InvalidAction as error:
                assert arm.name in str(error)  # noqa: PT017  it may be refused, and then says by whom
            passed = 0.0
            for _ in range(3):
                self.advance(self.tick)
                passed += self.tick
                state = arm.state()
                reach = self.speed_margin * limits.joint_velocity * max(passed, time.monotonic() - began)
                assert (np.abs(state.joints - joints) <= reach + self.tolerance).all()
                self.look_while_moving(arm)
            arm.hold()
            self.advance(self.stopping_time)
            assert self.is_at_rest(arm)
            assert not self.is_near(arm, far)
            assert arm.fault == ""

    def test_a_target_is_copied(self) -> None:
        """Later changes of the array do not reach the arm."""
        with self.open_device() as arm:
            target = self.target_of(arm)
            given = target.copy()
            self.command(arm, given)
            given[:] = math.nan
            self.require_reached(arm, target)

    def test_targets_are_numbers_of_any_kind(self) -> None:
        """Numbers of single precision, and every second one of a longer array, are accepted."""
        with self.open_device() as arm:
            target = self.target_of(arm)
            for given in (target.astype(np.float32), np.repeat(target, 2)[::2]):
                self.command(arm, given)
                self.require_reached(arm, target)

    def test_values_that_are_not_finite_are_refused_in_every_kind_of_command(self) -> None:
        """And times to live that are none; nothing moves."""
        with self.staying_device() as arm:
            for kind, send, size in (
                (CommandKind.joints, arm.command_joints, arm.dof),
                (CommandKind.twist, arm.command_twist, 6),
                (CommandKind.velocities, arm.command_velocities, arm.dof),
                (CommandKind.torques, arm.command_torques, arm.dof),
            ):
                if kind not in arm.commands():
                    continue
                for value in (math.nan, math.inf, -math.inf):
                    for i in range(size):
                        with pytest.raises(InvalidAction, match="valid is"):
                            send(np.where(np.arange(size) == i, value, 0.0))
                for valid_for in (0.0, -1.0, math.nan):
                    with pytest.raises(InvalidAction, match="valid for"):
                        send(np.zeros(size), valid_for)

    def test_an_arm_refuses_commands_of_a_kind_that_it_does_not_name(self) -> None:
        """And those of a wrong size where it names them; nothing moves."""
        with self.open_device() as arm:
            assert CommandKind.joints in arm.commands()
            if CommandKind.pose not in arm.commands():
                with pytest.raises(InvalidAction, match="takes no pose"):
                    arm.command_pose(Pose())
            for kind, send, needed in (
                (CommandKind.twist, arm.command_twist, 6),
                (CommandKind.velocities, arm.command_velocities, arm.dof),
                (CommandKind.torques, arm.command_torques, arm.dof),
            ):
                is_known = kind in arm.commands()
                with pytest.raises(InvalidAction, match="needed" if is_known else "takes no"):
                    send(np.zeros(needed + 1 if is_known else needed))
            assert self.is_at_rest(arm)
