"""Ports: what an environment needs of a device.

A port takes the device's part of an action and gives its part of an observation. Commands set targets and return; time
passes only in the environment's clock. Ports of simulated devices serve one copy and many.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from rcs.devices import Arm, Gripper
from rcs.envs import spaces as keys
from rcs.envs.spaces import Arrays, Observation
from rcs.kinematics import Kinematics

OVERSHOOT = 0.1
"""How far a joint may be measured outside its command limits [rad]: servos overshoot and collisions push."""


class Port(ABC):
    """One device, or several that are read together, as keys of actions and observations."""

    action_spaces: Mapping[str, spaces.Box]
    """Space of every key that the port takes."""
    observation_spaces: Mapping[str, spaces.Space[Any]]
    """Space of every key that the port gives."""

    @abstractmethod
    def command(self, action: Arrays) -> None:
        """Set the device's targets from the port's keys in a checked action."""

    @abstractmethod
    def observe(self) -> Observation:
        """Return the present observation, in arrays of its own."""

    def open(self) -> None:  # noqa: B027  most simulated devices have nothing to open
        """Connect the device."""

    def capture_times(self) -> dict[str, float]:
        """Return when each slow sensor was last read [s, monotonic clock], by its key such as `frames/wrist`."""
        return {}

    def has_arrived(self) -> bool:
        """Return whether the device has reached its last target."""
        return True

    def hold(self) -> None:  # noqa: B027  a camera has nothing to hold
        """Make the device stay where it is."""

    def faults(self) -> Mapping[str, str]:
        """Return the reason of every device that is in its fault state, by the device's name.

        The environment asks for it while it waits, so it must answer at once.
        """
        return {}

    def recover(self) -> None:  # noqa: B027  a simulated device has no faults
        """Clear the fault, if there is one; the device does not move."""

    def close(self) -> None:  # noqa: B027
        """Let go of the device; closing twice is harmless."""


def arm_observation_spaces(joints: spaces.Box) -> dict[str, spaces.Space[Any]]:
    """Return the observation spaces of an arm with a space of joint commands."""
    return {
        keys.JOINTS: keys.measured(joints, OVERSHOOT),
        keys.TQUAT: keys.tquat_space(),
        keys.XYZRPY: keys.xyzrpy_space(),
        keys.JOINT_VELOCITIES: keys.velocities_space(joints.shape[0]),
    }


class ArmPort(Port):
    """Any arm behind the device interface, written in C++ or Python, simulated or real."""

    def __init__(self, arm: Arm, kinematics: Kinematics) -> None:
        """Use an arm; it is opened by `open`.

        Args:
            arm: The device.
            kinematics: Gives the TCP pose from the measured joints.
        """
        limits = arm.limits
        box = keys.joints_space(limits.joint_lower, limits.joint_upper)
        self._arm = arm
        self._kinematics = kinematics
        self.action_spaces = {keys.JOINTS: box}
        self.observation_spaces = arm_observation_spaces(box)

    def command(self, action: Arrays) -> None:
        """Send the joint target."""
        self._arm.command_joints(action[keys.JOINTS])

    def observe(self) -> Observation:
        """Measure joints and compute the TCP pose."""
        state = self._arm.state()
        pose = self._kinematics.forward(state.joints)
        return {
            keys.JOINTS: state.joints,
            keys.TQUAT: pose.tquat,
            keys.XYZRPY: pose.xyzrpy,
            keys.JOINT_VELOCITIES: state.joint_velocities,
        }

    def open(self) -> None:
        """Connect the arm; it does not move."""
        self._arm.open()

    def has_arrived(self) -> bool:
        """Return whether the arm stands at its target."""
        return self._arm.has_arrived()

    def hold(self) -> None:
        """Stop the arm where it is."""
        _hold(self._arm)

    def faults(self) -> Mapping[str, str]:
        """Return why the arm stands still, if it is in its fault state."""
        return _fault_of(self._arm)

    def recover(self) -> None:
        """Clear the arm's fault."""
        if self._arm.is_open and self._arm.fault:
            self._arm.recover()

    def close(self) -> None:
        """Let go of the arm."""
        self._arm.close()


class GripperPort(Port):
    """Any gripper behind the device interface."""

    def __init__(self, gripper: Gripper) -> None:
        """Use a gripper; it is opened (connected) by `open`."""
        self._gripper = gripper
        self.action_spaces = {keys.GRIPPER: keys.normalised_space(1)}
        self.observation_spaces = {keys.GRIPPER: keys.normalised_space(1)}

    def command(self, action: Arrays) -> None:
        """Send the opening."""
        self._gripper.command_opening(float(action[keys.GRIPPER][0]))

    def observe(self) -> Observation:
        """Measure the opening."""
        opening = min(max(self._gripper.state().opening, 0.0), 1.0)
        return {keys.GRIPPER: np.array([opening], np.float32)}

    def open(self) -> None:
        """Connect the gripper; it does not move."""
        self._gripper.open()

    def has_arrived(self) -> bool:
        """Return whether the fingers stand still."""
        return self._gripper.has_arrived()

    def hold(self) -> None:
        """Stop the fingers where they are."""
        _hold(self._gripper)

    def faults(self) -> Mapping[str, str]:
        """Return why the gripper stands still, if it is in its fault state."""
        return _fault_of(self._gripper)

    def recover(self) -> None:
        """Clear the gripper's fault."""
        if self._gripper.is_open and self._gripper.fault:
            self._gripper.recover()

    def close(self) -> None:
        """Let go of the gripper."""
        self._gripper.close()


def _hold(device: Arm | Gripper) -> None:
    if not device.is_open:
        return
    try:
        device.hold()
    except Exception:
        # A device was held when it entered its fault state, and may refuse it now; the fault's reason says more.
        if not device.fault:
            raise


def _fault_of(device: Arm | Gripper) -> dict[str, str]:
    return {device.name: device.fault} if device.fault else {}
