"""The Franka Research 3 through `pylibfranka`, the vendor's own Python library, by torques at 1 kHz.

The library reads and writes single packets and holds the GIL while it waits: up to a millisecond, and up to a second if
the controller is silent. Therefore the arm runs in a host, a separate process (`FrankaDriver`), and the robot paces its
thread. Unlike with franky, a late torque is a missing packet.
"""

from __future__ import annotations

import sys
import time
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rcs.devices import ArmState, StreamedArm, StreamPoint
from rcs.errors import DeviceFault
from rcs.extras import package_of
from rcs.hardware.driver import require_fits
from rcs.hardware.franka import (
    GUIDING_DAMPING,
    JOINT_DAMPING,
    JOINT_STIFFNESS,
    TORQUE_STEP,
    FrankaOptions,
    stream_options,
)
from rcs.hardware.franka_faults import advice_for, connected, fault_of, make_idle, mode_of
from rcs.hardware.franka_limits import limits_of_fr3
from rcs.kinematics.chain import damped
from rcs.robots.description import ArmDescription
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND

RATE: Final = 1000.0
"""Rate of the robot's packets [Hz]."""
SWITCHING: Final = 1e-4
"""Python's thread switch interval in the host [s]. With the default of 5 ms, every other thread waits for five packets
each time it needs the GIL."""


class PylibfrankaArm(StreamedArm):
    """An FR3 under joint impedance control: torques pull the joints towards the reference like springs and dampers."""

    def __init__(self, address: str, about: ArmDescription, options: FrankaOptions) -> None:
        """Create the arm; `open` connects.

        Args:
            address: Address of the control box.
            about: Description of the arm.
            options: The site's options.

        Raises:
            InvalidSetup: The description is that of another arm.
        """
        require_fits("franka", about, FR3)
        super().__init__(
            f"{about.name} at {address}",
            limits_of_fr3(about, speed=options.speed, whole_range=options.whole_range),
            stream_options(RATE, is_stiff=options.compliance is None, is_paced_by_read=True),
        )
        self._address, self._about, self._options = address, about, options
        given = None if options.compliance is None else damped(options.compliance, about, FRANKA_HAND)
        self._stiffness = np.array(JOINT_STIFFNESS if given is None else given.joints)
        self._damping = np.array(JOINT_DAMPING if given is None else given.damping)
        self._library: Any = None
        self._robot: Any = None
        self._model: Any = None
        self._control: Any = None  # set while torques are sent
        self._state: Any = None  # the newest state
        self._led: NDArray[np.float64] | None = None
        self._is_led = self._is_given_way = self._has_link = False
        self._problem = ""
        self._interval = sys.getswitchinterval()

    def _open(self) -> None:
        self._library = library = package_of("pylibfranka", "pylibfranka", "The backend pylibfranka needs")
        ignore = library.RealtimeConfig.kIgnore
        self._robot = connected(lambda: library.Robot(self._address, ignore), self._address, "the arm")
        torque, force = self._options.thresholds(self._about)
        self._robot.set_collision_behavior(torque, torque, force, force)
        self._model = self._robot.load_model()
        sys.setswitchinterval(SWITCHING)
        self._has_link, self._problem = True, ""

    def _read(self) -> ArmState:
        state = self._next_state()
        self._problem = fault_of(state, self._about.joints) or self._problem
        if self._problem and not self._is_led and not self.fault:
            self.set_fault(self._problem)
        if self._is_given_way and self._control is not None:
            self._send(-np.array(GUIDING_DAMPING) * state.dq)
        return ArmState(
            list(state.q),
            list(state.dq),
            time=time.monotonic(),
            device_time=state.time.to_sec(),
            commanded_joints=list(state.q if self._led is None else self._led),
            efforts=list(state.tau_J),
            wrench=[-one for one in state.O_F_ext_hat_K],  # it reports the force of the arm on its environment
            mode=mode_of(state),
        )

    def _next_state(self) -> Any:
        """Wait for the robot's next packet."""
        try:
            if self._control is not None:
                try:
                    self._state, _ = self._control.readOnce()
                    return self._state
                except self._library.ControlException as err:
                    self._problem, self._control = str(err), None  # the motion is over; the robot keeps sending states
            self._state = self._robot.read_once()
        except RuntimeError as err:
            self._has_link, self._control = False, None
            raise DeviceFault(f"the controller has sent no state: {err}. {advice_for(self._address)}") from err
        return self._state

    def _start(self) -> None:
        self._is_given_way = False
        self._take_control()
        self._is_led = True

    def _take_control(self) -> None:
        if self._control is None:
            self._control = self._robot.start_torque_control()

    def _write(self, point: StreamPoint) -> None:
        if self._problem:
            raise DeviceFault(self._problem)
        state, self._led = self._state, np.array(point.position)
        mass = np.array(self._model.mass(state)).reshape(7, 7)
        pull = self._stiffness * (self._led - state.q) + self._damping * (np.array(point.velocity) - state.dq)
        self._send(pull + mass @ np.array(point.acceleration))

    def _send(self, torques: NDArray[np.float64]) -> None:
        """Send torques [N·m], shape (7,), without those for gravity, which the controller adds."""
        last = np.array(self._state.tau_J_d)
        torques = torques + self._model.coriolis(self._state)
        bounded = np.clip(torques, last - TORQUE_STEP, last + TORQUE_STEP)
        self._control.writeOnce(self._library.Torques(bounded.tolist()))

    def _stop(self) -> None:
        self._is_led = self._is_given_way = False
        self._led = self._control = None  # ends the motion

    def _can_guide(self) -> bool:
        return True

    def _guide(self) -> None:
        self._is_led, self._led = False, None
        self._take_control()
        self._is_given_way = True

    def _clear(self) -> None:
        self._stop()
        if not self._has_link:  # the library cannot reconnect
            self._close()
            self._open()
        make_idle(self._next_state, lambda: self._robot.automatic_error_recovery(), self._about.joints)
        self._problem = ""

    def _close(self) -> None:
        self._stop()
        self._robot = self._model = self._state = None
        sys.setswitchinterval(self._interval)
