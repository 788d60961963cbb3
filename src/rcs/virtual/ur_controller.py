"""A UR controller behind its ports: modes, safety system, and the program that moves the arm.

It moves the joints of a robot tick by tick, and stops them for the same reasons as a real controller: joint speed and
range, a path that the joints do not follow, the end of the program.
"""

from __future__ import annotations

import enum
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from rcs.kinematics import kinematics_of
from rcs.virtual.ur_motion import Chain, Motion, ProgramError, Reference, Stop
from rcs.virtual.virtual_robot import VirtualRobot

RATE: Final = 500
"""Ticks of the controller per second [Hz]."""
UNLOCK_AFTER: Final = 5.0
"""Time after which the dashboard unlocks a protective stop [s]; vendor's Dashboard Server manual."""
SPEED_LIMIT: Final = np.deg2rad(191.0)
"""Joint speed at which the safety system stops the arm [rad/s]; its factory setting, 11 degrees/s above the rated."""
TRACKING_LIMIT: Final = 0.3
"""Largest tracking error of a joint before the arm stops [rad]; our choice, since the vendor publishes none."""
STOP_DECELERATION: Final = 10.0
"""Deceleration of the joints in a protective stop and at the end of a program [rad/s²]; our choice."""


class RobotMode(enum.IntEnum):
    """RTDE's `robot_mode`."""

    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    RUNNING = 7


class SafetyMode(enum.IntEnum):
    """RTDE's `safety_mode`."""

    NORMAL = 1
    PROTECTIVE_STOP = 3
    SAFEGUARD_STOP = 5
    ROBOT_EMERGENCY_STOP = 7
    FAULT = 9


@dataclass
class Program:
    """The control script while it runs."""

    blocking: Callable[[], bool] | None = None
    """For a command that takes time, a function that returns True once it is done."""
    is_executing: bool = False
    """True if the present command has been executed but its register is not yet cleared."""
    watchdog: float = 0.0
    """Time without a write to the command register after which the program stops [s]; 0 for never."""
    heard: float = 0.0
    """Time of the last write to the command register, on the controller's clock [s]."""
    move: Motion | None = None
    """Motion that the program has requested."""
    has_freedrive: bool = False


@dataclass
class Registers:
    """Output registers of the program."""

    integers: list[int] = field(default_factory=lambda: [0] * 48)
    doubles: list[float] = field(default_factory=lambda: [0.0] * 48)


class UrController:
    """Moves an arm according to its program and stops it on faults."""

    def __init__(self, robot: VirtualRobot) -> None:
        """Start with the arm powered on, its brakes released, and no program.

        Args:
            robot: The arm; the installation's TCP is that of its gripper.
        """
        self.robot = robot
        self.about = robot.about
        self.lower, self.upper = np.array(robot.about.joint_lower), np.array(robot.about.joint_upper)
        flange = kinematics_of(robot.about)
        tcp = kinematics_of(robot.about, robot.gripper)
        home = np.array(robot.about.home)
        self.chain = Chain(flange, flange.forward(home).inverse() * tcp.forward(home))
        self.clock: Callable[[], float] = time.monotonic
        """The controller's clock [s]."""
        self.reference = Reference(robot.joints)
        """Reference of the arm's servos."""
        self.robot_mode = RobotMode.RUNNING
        self.safety_mode = SafetyMode.NORMAL
        self.bad_joint: int | None = None
        """Joint that caused a protective stop."""
        self.program: Program | None = None
        self.registers = Registers()
        self.payload = 0.0
        self._stopped_at = 0.0
        self._stop: Stop | None = None

    @property
    def is_running(self) -> bool:
        """True while a program runs."""
        return self.program is not None

    def start_program(self) -> None:
        """Run the control script if the arm is ready; end a running program first."""
        if self.safety_mode == SafetyMode.NORMAL and self.robot_mode == RobotMode.RUNNING:
            self.program = Program(heard=self.clock())
            self.registers = Registers()

    def mend(self) -> None:
        """Restore what a person restores at the pendant: buttons, power, safety system. A protective stop remains."""
        if self.safety_mode != SafetyMode.PROTECTIVE_STOP:
            self.safety_mode, self.bad_joint = SafetyMode.NORMAL, None
        if self.robot_mode != RobotMode.RUNNING:
            self.robot_mode = RobotMode.RUNNING
            self._stand()

    def unlock(self) -> str:
        """Leave a protective stop and return the dashboard's answer."""
        if self.safety_mode == SafetyMode.PROTECTIVE_STOP:
            if self.clock() - self._stopped_at < UNLOCK_AFTER:
                return (
                    "Cannot unlock protective stop until 5s after occurrence. "
                    "Always inspect cause of protective stop before unlocking"
                )
            self.safety_mode, self.bad_joint = SafetyMode.NORMAL, None
            self._stand()
        return "Protective stop releasing"

    def protect(self, reason: str, joint: int | None = None) -> None:
        """Enter a protective stop, which the dashboard can unlock; `joint` is the joint that caused it."""
        if self.safety_mode == SafetyMode.NORMAL:
            self.bad_joint = joint
            reason = reason if joint is None else f"{self.about.joints[joint]} {reason}"
            self.robot.note("protective_stop", reason=reason)
            self.safety_mode = SafetyMode.PROTECTIVE_STOP
            self._stopped_at = self.clock()
            self.end_program(f"protective stop: {reason}")

    def switch_off(self, safety_mode: SafetyMode) -> None:
        """Switch the power off."""
        self.end_program(f"switched off, {safety_mode.name}")
        self.safety_mode = safety_mode
        self.robot_mode = RobotMode.POWER_OFF

    # --- Motion ---

    def lead(self) -> None:
        """Move the reference by one tick, and the arm with it."""
        dt = 1 / RATE
        if self.robot_mode != RobotMode.RUNNING:
            self.robot.brake()
            self._stand()
            return
        program = self.program
        if program is not None and program.has_freedrive:
            self.robot.push(np.zeros(6))
            self._stand()
            return
        motion = self._stop or (None if program is None else program.move)
        if motion is None:
            self.reference.rest()
        else:
            try:
                is_over = motion.step(self.reference, dt)
            except ProgramError as err:
                self.end_program(str(err))
                is_over = False
            if is_over and motion is self._stop:
                self._stop = None
            elif is_over and program is not None:
                program.move = None
            self._watch()
        reference = self.reference
        self.robot.lead(reference.joints, reference.velocities, reference.accelerations)

    def _watch(self) -> None:
        """Stop the arm under the conditions of a real controller."""
        reference = self.reference
        speeds = np.abs(reference.velocities)
        if speeds.max() > SPEED_LIMIT:
            reference.velocities = np.clip(reference.velocities, -SPEED_LIMIT, SPEED_LIMIT)
            self.protect("is too fast", int(speeds.argmax()))
        inside = np.clip(reference.joints, self.lower, self.upper)
        if (inside != reference.joints).any():
            outside = inside != reference.joints
            reference.joints = inside
            reference.velocities = np.where(outside, 0.0, reference.velocities)
            self.protect("is at the end of its range", int(outside.argmax()))
        apart = np.abs(reference.joints - self.robot.joints)
        if apart.max() > TRACKING_LIMIT:
            self.protect("does not follow its path", int(apart.argmax()))

    def _stand(self) -> None:
        """Set the reference to the measured position."""
        self.reference = Reference(self.robot.joints)
        self._stop = None

    def end_program(self, reason: str) -> None:
        """End the program and brake its motion."""
        if self.program is not None:
            self.robot.note("program_ends", reason=reason)
            if self.program.has_freedrive:
                self._stand()
            self.program = None
        if self.reference.velocities.any():
            self._stop = Stop(STOP_DECELERATION)
