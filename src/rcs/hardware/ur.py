"""Arms of Universal Robots' e-series, over the vendor's RTDE interface, with the library ur-rtde.

`open` only reads. The first command uploads the library's control script, which takes 0.1 s; from then on joints are
streamed to it (servoj) up to 500 times a second, and the controller itself executes poses, twists and joint velocities.
A watchdog on the controller ends the script when no more packets arrive: the arm then brakes, even if this program has
crashed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Annotated, Any, Final

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from rcs.devices import Arm, ArmState, CommandKind, Gripper, StreamedArm, StreamOptions, StreamPoint
from rcs.errors import DeviceFault, InvalidSetup
from rcs.extras import package_of
from rcs.hardware.arm_options import TURN_PER_METRE, ArmOptions
from rcs.hardware.driver import Driver, require_address
from rcs.hardware.robotiq import RobotiqGripper
from rcs.hardware.tcp_ramp import TcpRamp
from rcs.hardware.ur_controller import (
    MODE_WORDS,
    SAFETY_WORDS,
    require_controller,
    require_ready_for_program,
    stop_program,
    unlock,
)
from rcs.robots.description import ArmDescription, GripperDescription
from rcs.spatial import Pose

TCP_ACCELERATION: Final = 1.2
"""Acceleration of the TCP [m/s²]; the default of the vendor's linear moves."""
AT_REST: Final = 1e-3
"""Speed below which a joint stands still [rad/s]."""

SILENCE: Final = 0.15
"""Time without a change of the controller's clock after which the arm is at fault [s]."""
REASON_TIME: Final = 0.05
"""Longest wait for the reason why the controller takes no commands [s]."""
PATIENCE: Final = 1.0
"""Timeout for new values from the controller after connecting and after unlocking it [s]."""
CLOCK_DRIFT: Final = 1e-4
"""Largest relative drift of the controller's clock against the host's [1]."""

OUTPUTS: Final = (
    "timestamp", "actual_q", "actual_qd", "target_q", "target_TCP_pose", "robot_mode", "safety_mode", "joint_mode",
    "runtime_state",
)  # fmt: skip
"""Outputs to read, by their RTDE names."""

# RTDE's numbers of modes that the dashboard names; vendor's guide "Real-Time Data Exchange".
_SAFETY_MODES = {
    3: "PROTECTIVE_STOP", 4: "RECOVERY", 5: "SAFEGUARD_STOP", 6: "SYSTEM_EMERGENCY_STOP", 7: "ROBOT_EMERGENCY_STOP",
    8: "VIOLATION", 9: "FAULT",
}  # fmt: skip
_ROBOT_MODES = {
    -1: "NO_CONTROLLER", 0: "DISCONNECTED", 1: "CONFIRM_SAFETY", 2: "BOOTING", 3: "POWER_OFF", 4: "POWER_ON",
    5: "IDLE", 6: "BACKDRIVE", 7: "RUNNING",
}  # fmt: skip
_JOINT_FAULTS = {245: "does not respond", 251: "is in violation", 252: "has a fault"}
_IS_RUNNING = 7
_IS_STOPPED, _IS_PLAYING = 1, 2


class UrOptions(ArmOptions):
    """A site's options for a UR arm."""

    rate: Annotated[float, Meta(ge=50.0, le=500.0)] = 500.0
    """Setpoints per second [Hz]."""
    watchdog: Annotated[float, Meta(ge=1.0, le=100.0)] = 20.0
    """Lowest rate of packets that the controller accepts [Hz]."""
    # A controller with acceleration = gain * (error - lookahead * speed) does not overshoot if gain >= 4 / lookahead².
    lookahead: Annotated[float, Meta(ge=0.03, le=0.2)] = 0.05
    """Lookahead of servoj [s]."""
    gain: Annotated[float, Meta(ge=100.0, le=2000.0)] = 1600.0
    """Gain of servoj."""


class UrArm(StreamedArm):
    """A UR arm: joints by servoj, joint velocities by speedj and, with a TCP, poses by servol and twists by speedl."""

    def __init__(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> None:
        """Create the arm; `open` connects.

        Args:
            address: IP address of the controller.
            about: Description of the arm.
            options: Those of `UrOptions`.

        Raises:
            InvalidSetup: An option does not exist or has an invalid value, the address is empty, or the description is
                that of another arm.
        """
        require_address("UR arm", address)
        if about.dof != 6:
            raise InvalidSetup(
                f"The driver ur controls arms of Universal Robots, with six joints; {about.name!r} has {about.dof}. "
                "Choose another robot or driver."
            )
        given = UrOptions.from_json(options)
        self._watchdog, self._lookahead, self._gain = given.watchdog, given.lookahead, given.gain
        self._tcp, self._tcp_speed = given.tcp_in_flange(), given.tcp_speed
        self._acceleration = min(about.acceleration_limit)
        more = {CommandKind.velocities} | ({CommandKind.pose, CommandKind.twist} if self._tcp else set())
        missed = max(math.ceil(given.rate / self._watchdog), 2)
        super().__init__(
            f"{about.name} at {address}",
            given.limits(about),
            StreamOptions(rate=given.rate, missed_ticks=missed, more_commands=more),
        )
        self._address = address
        self._about = about
        self._period = 1.0 / given.rate
        self._receive: Any = None
        self._control: Any = None
        self._trouble = ""
        self._ramp: TcpRamp | None = None
        self._kind = CommandKind.joints
        self._end = ""  # function that ends the script's thread in control of the joints
        self._is_led = False
        self._is_given_way = False
        self._may_run = False  # whether a script of this driver may run on the controller
        self._device_time = math.nan
        self._heard = 0.0
        self._offset = 0.0

    def _open(self) -> None:
        require_controller(self._address)
        receive = package_of("ur", "rtde_receive", "The driver `ur` needs")
        try:
            self._receive = receive.RTDEReceiveInterface(self._address, 500.0, list(OUTPUTS))
        except RuntimeError as err:
            raise DeviceFault(f"{self._address}: {err}") from err
        self._device_time, self._offset = math.nan, math.inf
        self._heard = time.monotonic()
        self._trouble = ""
        until = self._heard + PATIENCE
        while self._receive.getTimestamp() == 0.0:
            if time.monotonic() > until:
                raise DeviceFault(
                    f"{self._address}: the controller accepts the connection but sends no measurements; restart it"
                )
            time.sleep(0.002)

    def _read(self) -> ArmState:
        receive, now = self._receive, time.monotonic()
        device_time = receive.getTimestamp()
        if device_time != self._device_time:
            # The smallest delay so far is taken as that of the line; the clocks may drift apart.
            drifted = self._offset + CLOCK_DRIFT * (now - self._heard)
            self._offset = min(drifted, now - device_time)
            self._device_time, self._heard = device_time, now
        elif self._is_silent:
            raise DeviceFault(
                f"the controller has sent nothing new for {now - self._heard:.2f} s; it hangs, or the cable is "
                "unplugged. The watchdog on the controller stops the arm"
            )
        self._look()
        if self._is_given_way:
            self._control.kickWatchdog()
        return ArmState(
            receive.getActualQ(),
            receive.getActualQd(),
            time=device_time + self._offset,
            device_time=device_time,
            commanded_joints=receive.getTargetQ(),
            mode=_ROBOT_MODES.get(receive.getRobotMode(), "unknown").lower(),
        )

    @property
    def _is_silent(self) -> bool:
        return time.monotonic() - self._heard > SILENCE

    def _look(self) -> None:
        """Enter the fault state if the controller reports a fault; measurements stay readable."""
        receive = self._receive
        safety = receive.getSafetyMode()
        if safety in _SAFETY_MODES:
            name = _SAFETY_MODES[safety]
            joints = [
                f"{self._about.joints[index]} {_JOINT_FAULTS[mode]}"
                for index, mode in enumerate(receive.getJointMode())
                if mode in _JOINT_FAULTS
            ]
            trouble = "; ".join([SAFETY_WORDS[name], *joints])
        elif not self._is_led and not self._is_given_way:
            trouble = ""
        elif (mode := receive.getRobotMode()) != _IS_RUNNING:
            trouble = MODE_WORDS.get(_ROBOT_MODES.get(mode, ""), f"the robot mode is {mode}")
        elif (state := receive.getRuntimeState()) != _IS_PLAYING:
            self._may_run = self._may_run and state != _IS_STOPPED
            trouble = (
                "the control script on the controller has ended: a user stopped it or took local control, or this "
                f"program sent nothing for {1 / self._watchdog:.3f} s (watchdog)"
            )
        else:
            trouble = ""
        self._trouble = trouble
        if trouble and not self._is_led and not self.fault:  # otherwise `_write` reports it
            self.set_fault(trouble)

    def _start(self) -> None:
        self._ramp = None  # somebody may have moved the arm since
        if self._is_given_way:
            self._is_given_way = False
            self._control.endFreedriveMode()
        else:
            self._start_program()
        self._servo(self._receive.getActualQ())  # the script is slow with the first one
        self._is_led = True

    def _start_program(self) -> None:
        """Upload the control script and start its watchdog.

        Raises:
            DeviceFault: The arm is not ready, or another program controls it.
        """
        require_ready_for_program(self._address)
        control = package_of("ur", "rtde_control", "The driver `ur` needs")
        self._may_run = True
        try:
            if self._control is None:
                # The constructor holds the GIL: without this flag, until the script runs.
                make = control.RTDEControlInterface
                self._control = make(self._address, 500.0, make.FLAG_NO_WAIT)
            if not self._control.reuploadScript():
                raise DeviceFault(f"{self._address}: the control script cannot be uploaded")
        except RuntimeError as err:
            raise DeviceFault(f"{self._address}: {err}") from err
        self._end = ""
        until = time.monotonic() + 2.0
        while self._receive.getRuntimeState() != _IS_PLAYING or not self._control.isProgramRunning():
            if time.monotonic() > until:
                raise DeviceFault(f"{self._address}: the control script does not start; check the log on the pendant")
            time.sleep(0.002)
        # Without it, poses would be those of another frame.
        if self._tcp is not None and not self._control.setTcp([*self._tcp.translation, *self._tcp.rotvec]):
            raise DeviceFault(f"{self._address}: the controller refuses the TCP {self._tcp}; see the option `tcp`")
        if not self._control.setWatchdog(self._watchdog):
            raise DeviceFault(f"{self._address}: the controller refuses the watchdog")

    def _stop_program(self) -> None:
        """Stop the control script, and no program of somebody else."""
        if self._may_run:
            stop_program(self._address)
            self._may_run = False

    def _write(self, point: StreamPoint) -> None:
        self._ramp = None
        self._servo(point.position.tolist())

    def _servo(self, joints: list[float]) -> None:
        self._send("servoJ", joints, 0.0, 0.0, self._period, self._lookahead, self._gain)

    def _write_other(self, kind: CommandKind, values: NDArray[np.float64]) -> None:
        self._kind = kind
        if kind == CommandKind.pose:
            self._servo_to(Pose.from_tquat(values))
        elif kind == CommandKind.twist:
            fastest = self._tcp_speed * np.array([1.0, TURN_PER_METRE])
            excess = max(1.0, *(np.linalg.norm(values.reshape(2, 3), axis=1) / fastest))
            self._send("speedL", (values / excess).tolist(), TCP_ACCELERATION, 0.0)
        else:
            self._send("speedJ", values.tolist(), self._acceleration, 0.0)

    def _brake_other(self) -> bool:
        if self._kind == CommandKind.pose:
            self._servo_to(None)
            assert self._ramp is not None
            return self._ramp.is_still and self._is_at_rest
        zero = [0.0] * 6
        if self._kind == CommandKind.twist:
            self._send("speedL", zero, TCP_ACCELERATION, 0.0)
        else:
            self._send("speedJ", zero, self._acceleration, 0.0)
        return self._is_at_rest

    @property
    def _is_at_rest(self) -> bool:
        return max(map(abs, self._receive.getActualQd())) < AT_REST

    def _servo_to(self, goal: Pose | None) -> None:
        """Send the TCP's setpoint for the next tick."""
        if self._ramp is None:
            start = self._receive.getTargetTCPPose()
            turn = TURN_PER_METRE
            self._ramp = TcpRamp(
                Pose.from_rotvec(start[:3], start[3:]),
                (self._tcp_speed, turn * self._tcp_speed),
                (TCP_ACCELERATION, turn * TCP_ACCELERATION),
            )
        pose = self._ramp.advance(goal, self._period)
        target = [*pose.translation, *pose.rotvec]
        self._send("servoL", target, 0.0, 0.0, self._period, self._lookahead, self._gain)

    def _send(self, call: str, *values: Any) -> None:
        """Send a command to the control script.

        Raises:
            DeviceFault: The script takes no commands any more; the message says why.
        """
        if self._trouble:
            raise DeviceFault(self._trouble)
        # The script has a thread for servoing and one for speeds, and ends if both run. They change only at rest.
        end = "servoStop" if call.startswith("servo") else "speedStop"
        is_taken = self._end in ("", end) or getattr(self._control, self._end)()
        self._end = end
        if not (is_taken and getattr(self._control, call)(*values)):
            # One of the next outputs contains the reason.
            until = time.monotonic() + REASON_TIME
            while not self._trouble and time.monotonic() < until:
                time.sleep(0.002)
                self._look()
            raise DeviceFault(self._trouble or "the control script on the controller takes no commands any more")

    def _stop(self) -> None:
        self._is_led = self._is_given_way = False
        if self._is_silent:  # the watchdog stops it, and the next program may be another's
            self._may_run = False
        else:
            self._stop_program()

    def _can_guide(self) -> bool:
        return True

    def _guide(self) -> None:
        if self._is_led:
            if self._end:
                getattr(self._control, self._end)()
            self._end = ""
            self._is_led = False
        else:
            self._start_program()
        if not self._control.freedriveMode():
            raise DeviceFault(f"{self._address}: the controller refuses freedrive")
        self._is_given_way = True

    def _clear(self) -> None:
        self._is_led = self._is_given_way = False
        self._stop_program()  # commands from before the fault do not count
        unlock(self._address)
        if self._receive is None:  # an earlier attempt failed while it connected
            return self._open()
        # The next values were measured after that, over the old connections if they have survived.
        self._offset = math.inf
        before, until = self._receive.getTimestamp(), time.monotonic() + PATIENCE
        while self._receive.getTimestamp() == before or self._receive.getSafetyMode() in _SAFETY_MODES:
            if time.monotonic() > until:
                self._let_go()
                return self._open()
            time.sleep(0.002)
        self._heard = time.monotonic()
        self._trouble = ""
        return None

    def _close(self) -> None:
        self._let_go()

    def _let_go(self) -> None:
        self._is_led = self._is_given_way = False
        for interface in (self._control, self._receive):
            if interface is not None:
                interface.disconnect()
        self._control = self._receive = None


class UrDriver(Driver):
    """Driver of UR arms, and of Robotiq grippers connected to them, at the IP address of the controller."""

    hosted = True

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> Arm:
        """Return an arm; nothing is connected."""
        return UrArm(address, about, options)

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> Gripper:
        """Return a Robotiq gripper on the controller's URCap; nothing is connected."""
        return RobotiqGripper(address, about, options)
