"""Ports of simulated arms, grippers and hands, for one copy and for many."""

from __future__ import annotations

from rcs.envs import spaces as keys
from rcs.envs.ports.port import Port, arm_observation_spaces
from rcs.envs.spaces import Arrays, Observation
from rcs.sim.robot import SimRobot


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


class SimEffectorPort(Port):
    """The gripper or the hand of a simulated robot."""

    def __init__(self, robot: SimRobot) -> None:
        """Use a robot's end effector."""
        self._robot = robot
        self._is_hand = robot.placement.hand is not None
        key, size = (keys.HAND, len(robot.hand.joints)) if self._is_hand else (keys.GRIPPER, 1)
        self.action_spaces = {key: keys.normalised_space(size)}
        self.observation_spaces = {key: keys.normalised_space(size)}

    def command(self, action: Arrays) -> None:
        """Set the opening, or the targets of the joints."""
        if self._is_hand:
            self._robot.command_hand(action[keys.HAND])
        else:
            self._robot.command_opening(action[keys.GRIPPER])

    def hold(self) -> None:
        """Set the measured joints of a hand as the target; a gripper goes on to hold what is in it."""
        if self._is_hand:
            self._robot.command_hand(self._robot.hand_joints)

    def kept(self) -> Arrays:
        """Return the target of a gripper."""
        return {} if self._is_hand else {keys.GRIPPER: self._robot.opening_target}

    def observe(self) -> Observation:
        """Read the opening, or the joints."""
        robot = self._robot
        return {keys.HAND: robot.hand_joints} if self._is_hand else {keys.GRIPPER: robot.opening}
