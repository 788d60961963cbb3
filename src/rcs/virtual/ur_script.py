"""The control script of ur_rtde, emulated on a virtual UR.

A command is in `input_int_register_0`, its arguments are in the double registers, and its state is in
`output_int_register_0`. A watchdog ends the program when its client falls silent.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rcs.virtual.rtde_port import RtdePort
from rcs.virtual.ur_controller import STOP_DECELERATION, Program, UrController
from rcs.virtual.ur_motion import ProgramError, Servo, SpeedJoints, SpeedTcp, Stop, pose_of

Vector = NDArray[np.float64]

_READY, _DONE = 1, 2
_REAL_TIME: Final = (9, 10, 11, 24)


class ControlScript:
    """Executes the commands in the registers."""

    def __init__(self, controller: UrController, rtde: RtdePort) -> None:
        """Connect the registers of a port to a controller."""
        self._controller, self._rtde = controller, rtde
        rtde.heed = self._log_point

    def run(self) -> None:
        """Run one cycle of the script's main loop."""
        program = self._controller.program
        if program is None:
            return
        if "input_int_register_0" in self._rtde.was_set:
            program.heard = self._controller.clock()
        elif 0 < program.watchdog < self._controller.clock() - program.heard:
            self._controller.end_program("watchdog")
            return
        integers = self._controller.registers.integers
        command = self._rtde.registers["input_int_register_0"]
        try:
            if command in _REAL_TIME:
                self._start_real_time(program, command)
                integers[0] = _READY
            elif command == 0:
                program.is_executing, program.blocking = False, None
                integers[0] = _READY
            elif not program.is_executing:
                program.is_executing = True
                program.blocking = self._execute(program, command)
            if program.blocking is not None and program.blocking():
                program.blocking = None
                integers[0] = _DONE
        except ProgramError as err:
            self._controller.end_program(str(err))

    def _arguments(self, count: int) -> Vector:
        """Return the first arguments of a command, shape (count,).

        Raises:
            ProgramError: Some are not finite.
        """
        values = self._doubles(count)
        if not np.isfinite(values).all():
            raise ProgramError(f"the arguments of a command are not finite: {values.tolist()}")
        return values

    def _doubles(self, count: int) -> Vector:
        """Return the first double input registers, shape (count,)."""
        registers = self._rtde.registers
        return np.array([registers[f"input_double_register_{i}"] for i in range(count)])

    def _log_point(self) -> None:
        if self._rtde.registers["input_int_register_0"] == 11:
            self._controller.robot.log_point(joints=self._doubles(6))

    def _start_real_time(self, program: Program, command: int) -> None:
        """Start a command that the client repeats at any rate."""
        values = self._arguments(11)
        allowed = Servo if command in (11, 24) else SpeedJoints | SpeedTcp
        if program.move is not None and not isinstance(program.move, allowed):
            raise ProgramError("Another thread is already controlling the robot")
        if command in (11, 24):
            target = (
                values[:6]
                if command == 11
                else self._controller.chain.inverse(pose_of(values), self._controller.reference.joints)
            )
            if isinstance(program.move, Servo):
                program.move.target, program.move.lookahead, program.move.gain = target, values[9], values[10]
            else:
                program.move = Servo(target, values[9], values[10])
        elif command == 9:
            program.move = SpeedJoints(values[:6], values[6])
        elif isinstance(program.move, SpeedTcp):
            program.move.twist, program.move.acceleration = values[:6], values[6]
        else:
            program.move = SpeedTcp(values[:6], values[6], self._controller.chain)

    def _execute(self, program: Program, command: int) -> Callable[[], bool]:
        """Start a command and return a function that returns True once it is done.

        Raises:
            ProgramError: The command does not exist or cannot be executed.
        """
        values = self._arguments(14)
        match command:
            case 15 | 16 | 33 | 34:
                # Linear stops brake along the joints, too, and deviate little from a straight line.
                program.move = Stop(STOP_DECELERATION if command == 16 else min(values[0], STOP_DECELERATION))
                return lambda: program.move is None
            case 17:
                self._controller.payload = values[0]
            case 18 | 52:
                program.move, program.has_freedrive = None, True
            case 19 | 53:
                program.has_freedrive = False
            case 29:
                self._controller.chain.tcp_in_flange = pose_of(values)
            case 31:
                self._controller.protect("asked for by the program")
            case 35:
                program.watchdog, program.heard = 1 / values[0], self._controller.clock()
            case 255:
                self._controller.end_program("stop script")
            case _:
                raise ProgramError(f"the command {command} of the control script is not known to this virtual robot")
        return lambda: True
