"""A real device whose body in the simulated world follows it, so that simulated cameras and robots see it move."""

from __future__ import annotations

import numpy as np

from rcs.envs.ports.port import Port
from rcs.envs.spaces import GRIPPER, HAND, JOINTS, Arrays, Observation
from rcs.sim.robot import SimRobot

JUMP = 0.2
"""A joint that is farther from its body in the world than this is put there at once [rad]: an episode has begun."""


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
