"""Ports of simulated arms, grippers and hands, for one copy and for many."""

from __future__ import annotations

import numpy as np

from rcs.envs import spaces as keys
from rcs.envs.ports.port import Port, arm_observation_spaces
from rcs.envs.spaces import GRIPPER, HAND, JOINTS, Arrays, Observation
from rcs.sim.robot import SimRobot

JUMP = 0.2
"""A joint that is farther from its body in the world than this is put there at once [rad]: an episode has begun."""


class SimArmPort(Port):
    """The arm of a simulated robot."""

    def __init__(self, robot: SimRobot) -> None:
        """Use a robot's arm."""
        arm = robot.placement.arm
        box = keys.joints_space(arm.joint_lower, arm.joint_upper)
        self._robot = robot
        self.joint_space = box
        self.action_spaces = {keys.JOINTS: box}
        self.observation_spaces = arm_observation_spaces(box)

    def command(self, action: Arrays) -> None:
        """Set the joint targets."""
        self._robot.command_joints(action[keys.JOINTS])

    def hold(self) -> None:
        """Stop the arm where it is."""
        self._robot.stop()

    def rebase(self) -> None:
        """Go on from the measured joints, also where they were pushed to."""
        self._robot.stop()

    def observe(self) -> Observation:
        """Read joints, velocities and the TCP pose."""
        robot = self._robot
        return {
            keys.JOINTS: robot.joints,
            keys.TQUAT: robot.tcp_tquat,
            keys.XYZRPY: robot.tcp_xyzrpy,
            keys.JOINT_VELOCITIES: robot.joint_velocities,
        }


class SimGripperPort(Port):
    """The gripper of a simulated robot."""

    def __init__(self, robot: SimRobot) -> None:
        """Use a robot's gripper."""
        self._robot = robot
        self.action_spaces = {keys.GRIPPER: keys.normalised_space(1)}
        self.observation_spaces = {keys.GRIPPER: keys.normalised_space(1)}

    def command(self, action: Arrays) -> None:
        """Set the opening."""
        self._robot.command_opening(action[keys.GRIPPER])

    def observe(self) -> Observation:
        """Read the opening."""
        return {keys.GRIPPER: self._robot.opening}


class SimHandPort(Port):
    """The hand of a simulated robot."""

    def __init__(self, robot: SimRobot) -> None:
        """Use a robot's hand."""
        self._robot = robot
        size = len(robot.hand.joints)
        self.action_spaces = {keys.HAND: keys.normalised_space(size)}
        self.observation_spaces = {keys.HAND: keys.normalised_space(size)}

    def command(self, action: Arrays) -> None:
        """Set the joint targets."""
        self._robot.command_hand(action[keys.HAND])

    def hold(self) -> None:
        """Set the measured joints as the target."""
        self._robot.command_hand(self._robot.hand_joints)

    def observe(self) -> Observation:
        """Read the joints."""
        return {keys.HAND: self._robot.hand_joints}


class FollowPort(Port):
    """A real device; its simulated body is driven to where it is measured."""

    def __init__(self, body: SimRobot, port: Port) -> None:
        """Have the body of a robot follow one of its devices."""
        self._body = body
        self._port = port
        self.device = port.device
        self.timed = port.timed
        self.joint_space = port.joint_space
        self.action_spaces = port.action_spaces
        self.observation_spaces = port.observation_spaces

    def command(self, action: Arrays) -> None:
        """Command the device."""
        self._port.command(action)

    def observe(self) -> Observation:
        """Measure the device, and have the body follow."""
        measured = self._port.observe()
        if JOINTS in measured:
            if np.abs(measured[JOINTS] - self._body.joints).max() > JUMP:
                self._body.put(measured[JOINTS])
                self._body.world.refresh()
            self._body.command_joints(measured[JOINTS])
        if GRIPPER in measured:
            self._body.command_opening(measured[GRIPPER])
        if HAND in measured:
            self._body.command_hand(measured[HAND])
        return measured

    def capture_times(self) -> dict[str, float]:
        """Return when the device was measured."""
        return self._port.capture_times()

    def open(self) -> None:
        """Connect the device; it does not move."""
        self._port.open()

    def hold(self) -> None:
        """Make the device stay where it is."""
        self._port.hold()

    def recover(self) -> None:
        """Clear the device's fault, if there is one."""
        self._port.recover()

    def close(self) -> None:
        """Let go of the device; closing twice is harmless."""
        self._port.close()
