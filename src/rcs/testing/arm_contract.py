"""What every arm must do, as tests."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.devices import Arm, ArmState, CommandKind
from rcs.errors import InvalidAction
from rcs.spatial import Pose
from rcs.testing.device_contract import MotionContract


class ArmContract(MotionContract[Arm]):
    """Checks an arm. Moves it by `distance` at every joint, several times: clear its surroundings first."""

    distance: float = 0.1
    """How far every joint moves [rad], towards the middle of its limits."""
    tolerance: float = 2e-3
    """How close to its target an arm must come, and how far one that stands still may move [rad]."""
    speed_margin: float = 1.05
    """By which factor a measured speed may exceed the limit: measurements are noisy."""

    def make_arm(self) -> Arm:
        """Return a new arm, not opened. To be overridden."""
        raise NotImplementedError("override make_arm and return a new arm that is not opened")

    def make_device(self) -> Arm:
        """Return a new arm."""
        return self.make_arm()

    def measure(self, device: Arm) -> ArmState:
        """Return what the arm measures."""
        return device.state()

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

    def bad_targets(self, device: Arm) -> list[NDArray[np.float64]]:
        """Return targets of a wrong size, not finite and out of limits."""
        joints, limits = self.position(device), device.limits
        values = (math.nan, math.inf, -math.inf, limits.joint_upper[0] + 0.01, limits.joint_lower[0] - 0.01)
        bad = [np.array([value, *joints[1:]]) for value in values]
        return [np.zeros(0), joints[1:], np.append(joints, 0.0), *bad]

    def look_while_moving(self, device: Arm) -> None:
        """Check that no joint is faster than it may."""
        limit = device.limits.joint_velocity * self.speed_margin
        assert (np.abs(device.state().joint_velocities) <= limit).all()

    def test_a_state_has_a_finite_value_for_every_joint(self) -> None:
        """What the arm does not measure is empty; measurements are copies."""
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
