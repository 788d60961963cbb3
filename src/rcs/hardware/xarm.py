"""The xArm7 of UFACTORY, with the vendor's library xarm-python-sdk.

`open` only reads. The first command enables the motors and enters servo mode, in which the controller moves the joints
to each setpoint at once; this side enforces the limits of speed, acceleration and jerk. If the program is killed, the
arm stays at the last setpoint.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Final

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from rcs.devices import Arm, ArmState, CommandKind, Gripper, StreamedArm, StreamOptions, StreamPoint
from rcs.errors import DeviceFault
from rcs.hardware.arm_options import TURN_PER_METRE, ArmOptions
from rcs.hardware.driver import Driver, require_address, require_fits
from rcs.hardware.robotiq import RobotiqGripper
from rcs.hardware.tcp_ramp import TcpRamp
from rcs.hardware.xarm_controller import CODE_WORDS, STATE_WORDS, XarmTool, connect, others_on, require_controller
from rcs.kinematics import kinematics_of
from rcs.robots.description import ArmDescription, GripperDescription
from rcs.robots.xarm7 import XARM7
from rcs.spatial import Pose

SPEED: Final = 0.12
"""Default fraction of the joint speeds, at which the TCP stays below `FASTEST_TCP` in every pose, even with all joints
at full speed in the worst directions: of 10⁵ random poses with a tool of 0.2 m, the worst has 2.48 m/rad."""
FASTEST_TCP: Final = 0.95
"""Largest speed of the TCP in servo mode [m/s]; the firmware stops the arm at 1 to 1.2 m/s."""
TCP_ACCELERATION: Final = 1.2
"""Acceleration of the TCP [m/s²]; our choice."""
AT_REST: Final = 1e-2
"""Speed below which a joint stands still [rad/s]."""

SILENCE: Final = 0.2
"""Time without an answer after which the arm is at fault [s]."""
ASK_AGAIN: Final = 0.04
"""Time without an answer after which a request or setpoint is repeated, as packets may be lost [s]."""
SETTLING: Final = 0.1
"""Wait after a change of mode [s]; from the vendor's examples."""
PATIENCE: Final = 1.0
"""Timeout for a change of state [s]."""

_STOPPED, _MOVING, _SERVO, _MANUAL = 4, 1, 1, 2
_HAS_ERROR, _HAS_WARNING, _NO_ANSWER, _NOT_READY, _REFUSED = 1, 2, 3, 9, 10  # return codes of the library


class XarmOptions(ArmOptions):
    """A site's options for an xArm."""

    rate: Annotated[float, Meta(ge=30.0, le=250.0)] = 250.0
    """Setpoints per second [Hz]."""
    speed: Annotated[float, Meta(ge=0.01, le=1.0)] = SPEED
    """Fraction of the description's joint speeds."""
    tcp_speed: Annotated[float, Meta(ge=0.001, le=FASTEST_TCP)] = 0.25
    """Limit of the TCP's speed for poses [m/s]."""


class XarmArm(StreamedArm):
    """An xArm7 in servo mode, controlled by joints and, with a TCP, by poses."""

    def __init__(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> None:
        """Create the arm; `open` connects.

        Args:
            address: IP address of the controller.
            about: Description of the arm.
            options: Those of `XarmOptions`.

        Raises:
            InvalidSetup: An option does not exist or has an invalid value, the address is empty, or the description is
                that of another arm.
        """
        require_address("xArm", address)
        require_fits("xarm", about, XARM7)
        given = XarmOptions.from_json(options)
        self._tcp, self._tcp_speed = given.tcp_in_flange(), given.tcp_speed
        more = {CommandKind.pose} if self._tcp else set[CommandKind]()
        super().__init__(
            f"{about.name} at {address}",
            given.limits(about),
            StreamOptions(rate=given.rate, missed_ticks=max(round(given.rate * SILENCE), 2), more_commands=more),
        )
        self._address = address
        self._flange = kinematics_of(about)
        self._period = 1.0 / given.rate
        self._api: Any = None
        self._trouble = ""
        self._heard = 0.0
        self._is_led = False
        self._is_given_way = False
        self._is_ours = False  # whether the mode of the arm is that of this driver
        self._ramp: TcpRamp | None = None
        self._place: NDArray[np.float64] | None = None
        self._sent: NDArray[np.float64] | None = None

    def _open(self) -> None:
        require_controller(self._address)
        self._api = connect(self._address)
        self._api.set_timeout(SILENCE)
        self._heard = time.monotonic()
        self._trouble = ""

    def _read(self) -> ArmState:
        begin = time.monotonic()
        _, (joints, velocities, efforts) = self._ask(lambda: self._api.get_joint_states(is_radian=True, num=3))
        self._look()
        return ArmState(
            joints,
            velocities,
            time=0.5 * (begin + self._heard),
            commanded_joints=[] if self._sent is None else self._sent.tolist(),
            efforts=efforts,
            mode="servo" if self._is_led else "manual" if self._is_given_way else "",
        )

    def _ask(self, call: Callable[[], Any]) -> Any:
        """Call the library, repeatedly if there is no answer, and return the result.

        Raises:
            DeviceFault: There is no answer for `SILENCE` seconds.
        """
        self._api.set_timeout(ASK_AGAIN)
        try:
            while True:
                found = call()
                code = found[0] if isinstance(found, list | tuple) else found
                if code != _NO_ANSWER or self._is_silent:
                    self._require_answer(code)
                    return found
        finally:
            self._api.set_timeout(SILENCE)

    def _require_answer(self, code: int) -> None:
        """Check that the controller has answered a call.

        Raises:
            DeviceFault: It has not.
        """
        if code == _NO_ANSWER:
            raise DeviceFault(
                f"the controller has not answered for {time.monotonic() - self._heard:.2f} s; it hangs, or the cable is"
                " unplugged. The arm stays at the last setpoint"
            )
        if code not in (0, _HAS_ERROR, _HAS_WARNING, _NOT_READY, _REFUSED):
            raise DeviceFault(f"the connection to the controller is lost (the library returns {code})")
        self._heard = time.monotonic()

    @property
    def _is_silent(self) -> bool:
        return self._api is None or time.monotonic() - self._heard > SILENCE

    def _look(self) -> None:
        """Enter the fault state if the controller reports a fault; measurements stay readable."""
        if self._api.core.has_err_warn:
            _, (error, _) = self._ask(self._api.get_err_warn_code)
            self._trouble = _words(error) if error else ""
        else:
            self._trouble = ""
        if not self._trouble and (self._is_led or self._is_given_way) and not self._api.core.state_is_ready:
            _, state = self._ask(self._api.get_state)
            if not self._api.core.state_is_ready:
                self._trouble = STATE_WORDS.get(state, f"the state of the controller is {state}")
        if self._trouble and not self._is_led and not self.fault:  # otherwise `_send` reports it
            self.set_fault(self._trouble)

    def _start(self) -> None:
        if self._is_given_way:
            self._is_given_way = False
            if self._trouble:  # someone has stopped the arm, which must not be enabled again
                raise DeviceFault(self._trouble)
        else:
            self._require_free()
        self._enter(_SERVO)
        self._ramp = self._place = self._sent = None
        self._is_led = True

    def _require_free(self) -> None:
        """Check that no other program moves the arm.

        Raises:
            DeviceFault: One does.
        """
        _, state = self._ask(self._api.get_state)
        if state == _MOVING:
            raise DeviceFault(
                f"{self._address}: another program already moves the arm ({others_on(self._address)}); end it"
            )

    def _enter(self, mode: int) -> None:
        """Enable the motors and enter a mode.

        Raises:
            DeviceFault: The controller refuses; the message says why.
        """
        api, self._is_ours = self._api, True
        code = api.motion_enable(True)  # the library waits 5 s for the brakes
        if code == _NO_ANSWER:
            self._ask(api.get_state)  # if it answers, only a packet was lost
            code = api.motion_enable(True)
        self._require_answer(code)
        if self._tcp is not None:
            tcp = self._tcp.xyzrpy
            code = self._ask(lambda: api.set_tcp_offset([*(1e3 * tcp[:3]), *tcp[3:]], is_radian=True, wait=False))
            if code == _REFUSED:  # poses would be those of another frame
                raise DeviceFault(f"{self._address}: the controller refuses the TCP {self._tcp}; see the option `tcp`")
        self._ask(lambda: api.set_mode(mode))
        self._ask(lambda: api.set_state(0))
        until = time.monotonic() + PATIENCE
        while not api.core.state_is_ready:
            self._look()
            if self._trouble or time.monotonic() > until:
                _, state = self._ask(api.get_state)
                raise DeviceFault(
                    f"{self._address}: the controller blocks the arm: "
                    + (self._trouble or STATE_WORDS.get(state, f"its state is {state}"))
                )
            time.sleep(0.01)
            self._ask(api.get_state)
        time.sleep(SETTLING)

    def _write(self, point: StreamPoint) -> None:
        joints = point.position
        place = (self._flange.forward(joints) * (self._tcp or Pose())).translation
        if self._place is not None:
            speed = float(np.linalg.norm(place - self._place)) / self._period
            if speed > FASTEST_TCP:
                raise DeviceFault(
                    f"the commanded speed of the TCP is {speed:.2f} m/s, valid is at most {FASTEST_TCP:g} m/s in servo"
                    " mode; lower the option `speed`, or command slower motions"
                )
        self._place, self._ramp, self._sent = place, None, joints
        self._send(self._api.set_servo_angle_j, joints.tolist())

    def _write_other(self, kind: CommandKind, values: NDArray[np.float64]) -> None:
        self._servo_to(Pose.from_tquat(values))

    def _brake_other(self) -> bool:
        self._servo_to(None)
        assert self._ramp is not None
        _, rows = self._ask(lambda: self._api.get_joint_states(is_radian=True, num=2))
        return self._ramp.is_still and max(map(abs, rows[1])) < AT_REST

    def _servo_to(self, goal: Pose | None) -> None:
        """Send the TCP's setpoint for the next tick."""
        if self._ramp is None:
            _, start = self._ask(lambda: self._api.get_position(is_radian=True))
            turn = TURN_PER_METRE
            self._ramp = TcpRamp(
                Pose.from_xyzrpy([*(1e-3 * np.array(start[:3])), *start[3:]]),
                (self._tcp_speed, turn * self._tcp_speed),
                (TCP_ACCELERATION, turn * TCP_ACCELERATION),
            )
        pose = self._ramp.advance(goal, self._period).xyzrpy
        self._place = self._sent = None
        self._send(self._api.set_servo_cartesian, [*(1e3 * pose[:3]), *pose[3:]])

    def _send(self, call: Any, values: list[float]) -> None:
        """Send a setpoint to the controller.

        Raises:
            DeviceFault: The controller takes no setpoints any more; the message says why.
        """
        if self._trouble:
            raise DeviceFault(self._trouble)
        code = self._ask(lambda: call(values, is_radian=True))
        if code in (_HAS_ERROR, _NOT_READY, _REFUSED):
            self._look()
            raise DeviceFault(self._trouble or f"the controller refuses a setpoint (the library returns {code})")

    def _stop(self) -> None:
        self._is_led = self._is_given_way = False
        self._sent = None
        if self._is_ours and not self._is_silent:  # a silent one stands at the last setpoint
            self._ask(lambda: self._api.set_state(_STOPPED))
            self._is_ours = False

    def _can_guide(self) -> bool:
        return True

    def _guide(self) -> None:
        if not self._is_ours:
            self._require_free()
        self._is_led = False
        self._sent = None
        self._enter(_MANUAL)
        self._is_given_way = True

    def _clear(self) -> None:
        is_ours = self._is_ours
        self._is_led = self._is_given_way = self._is_ours = False
        if self._is_silent or not self._api.connected:
            self._let_go()
            self._open()
        api = self._api
        self._ask(api.clean_error)
        self._ask(api.clean_warn)
        _, (error, _) = self._ask(api.get_err_warn_code)
        if error:
            raise DeviceFault(f"the error remains: {_words(error)}")
        _, state = self._ask(api.get_state)
        if is_ours or state != _MOVING:  # not an arm that another program moves
            self._ask(lambda: api.set_state(_STOPPED))  # discard setpoints from before the fault
        self._trouble = ""

    def _close(self) -> None:
        self._let_go()

    def _let_go(self) -> None:
        self._is_led = self._is_given_way = self._is_ours = False
        self._sent = None
        if self._api is not None:
            self._api.disconnect()
        self._api = None


class XarmDriver(Driver):
    """Driver of UFACTORY's arms, and of Robotiq grippers at their flange, at the IP address of the controller."""

    hosted = True

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> Arm:
        """Return an arm; nothing is connected."""
        return XarmArm(address, about, options)

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> Gripper:
        """Return a Robotiq gripper at the flange; nothing is connected."""
        return RobotiqGripper(address, about, options, XarmTool)


def _words(error: int) -> str:
    """Return the meaning of a controller error."""
    return f"C{error}: {CODE_WORDS.get(error, 'see the manual of the xArm')}"
