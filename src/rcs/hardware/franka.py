"""The Franka Research 3 and the Franka Hand, on the vendor's network interface (FCI), through `franky-control`.

`franka_pylibfranka` controls the same arm through the vendor's own Python library.

Timing: franky's own C++ thread answers the robot 1000 times a second. It computes torques from a reference that the
arm's thread updates `RATE` times a second. A late update leaves the reference where it is; the robot misses no packet.
The arm therefore needs no real-time kernel on a computer that is otherwise idle.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray
from rcs_data.options import NotNegative, Record

from rcs.devices import Arm, ArmState, StreamedArm, StreamOptions, StreamPoint
from rcs.errors import DeviceFault, InvalidSetup, require_fields
from rcs.extras import package_of
from rcs.hardware.driver import Driver, require_address, require_fits
from rcs.hardware.franka_faults import advice_for, connected, fault_of, make_idle, mode_of, within
from rcs.hardware.franka_hand import FrankaHand
from rcs.hardware.franka_limits import limits_of_fr3
from rcs.kinematics import kinematics_of
from rcs.kinematics.chain import damped
from rcs.robots.compliance import Compliance
from rcs.robots.description import ArmDescription, GripperDescription
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND

RATE: Final = 1000.0
"""Rate of updates of the reference [Hz]."""
STALL: Final = 0.1
"""Longest time without an update of the reference, during which the arm keeps to the last one [s]; our choice."""
STOPPING: Final = 0.5
"""Timeout for the confirmation of a stop [s]."""
TORQUE_STEP: Final = 0.99
"""Largest change of a torque per millisecond [N·m]; the robot admits 1.0."""
NO_CUTOFF: Final = 1000.0
"""Cutoff frequency at which the library's low-pass filter is off [Hz]; libfranka, lowpass_filter.h."""
SILENCE: Final = 0.2
"""Age of the last state from which the controller counts as silent [s]; it sends one every millisecond."""
REASON_TIME: Final = 0.02
"""Longest wait for a state with the reason of a motion's end, which the library reports before [s]."""

# Joints 1 to 4: libfranka, examples/joint_impedance_control.cpp. The wrist is light and has more stiffness and less
# damping than in that example, so that it follows within 0.1 s instead of 0.3 s (our choice).
JOINT_STIFFNESS: Final = (600.0, 600.0, 600.0, 600.0, 300.0, 200.0, 100.0)
JOINT_DAMPING: Final = (50.0, 50.0, 50.0, 50.0, 20.0, 12.0, 6.0)
GUIDING_DAMPING: Final = (2.0, 2.0, 2.0, 2.0, 0.5, 0.5, 0.5)
"""Joint damping while a person guides the arm [N·m·s/rad]; our choice."""
POSTURE_STIFFNESS: Final = 5.0
"""Joint stiffness that holds the elbow in place when the TCP is controlled [N·m/rad]; our choice."""

_log = logging.getLogger(__name__)

Backend = Literal["franky", "pylibfranka"]
Vector = NDArray[np.float64]
JointTorques = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]


class FrankaOptions(Record):
    """A site's options for an arm."""

    backend: Backend = "franky"
    """Library that controls the arm; `pylibfranka`, the vendor's, takes joints only and runs in a separate process."""
    compliance: Compliance | None = None
    """Compliance of the arm, from the setup; None for joints as stiff as is safe."""
    collision_torque: JointTorques | None = None
    """Collision threshold of the external torque at each joint [N·m], 7 values; None for the description's."""
    collision_force: NotNegative | None = None
    """Collision threshold of the force [N] and moment [N·m] at the TCP; None for the description's."""
    speed: Annotated[float, Meta(gt=0.0, le=1.0)] = 1.0
    """Fraction of the joint speed limits to use, above 0 and at most 1."""
    whole_range: bool = False
    """Use the full joint ranges and speeds. Fast motions towards the end of a range then trigger a reflex."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidSetup: A value is invalid.
        """
        super().__post_init__()
        if self.backend == "pylibfranka" and self.compliance is not None and self.compliance.is_of_tcp:
            raise InvalidSetup(
                "TCP compliance needs the backend 'franky'; 'pylibfranka' supports joint compliance only."
            )

    def thresholds(self, about: ArmDescription) -> tuple[list[float], list[float]]:
        """Return the collision thresholds: 7 joint torques [N·m], and 6 forces [N] and moments [N·m] at the TCP."""
        limits = about.collision
        assert limits is not None, "the description of an FR3 has them"
        force = [limits.force] * 3 + [limits.moment] * 3 if self.collision_force is None else [self.collision_force] * 6
        return list(limits.joint_torque if self.collision_torque is None else self.collision_torque), force


def stream_options(rate: float, *, is_stiff: bool, is_paced_by_read: bool = False) -> StreamOptions:
    """Return how an FR3 is streamed to; one that gives way may be farther from where it is led."""
    return StreamOptions(
        rate=rate,
        is_paced_by_read=is_paced_by_read,
        missed_ticks=round(rate * STALL),
        arrival=0.005 if is_stiff else 0.05,
        tracking_error=0.3 if is_stiff else 1.0,
    )


class FrankaDriver(Driver):
    """Driver of arms and hands at the address of a control box. An arm takes the options of `FrankaOptions`."""

    hosted = True
    gives_way = True

    def library(self, options: Mapping[str, Any]) -> str:
        """Return `pylibfranka` for an arm with that backend, which ships its own libfranka."""
        return "pylibfranka" if options.get("backend") == "pylibfranka" else ""

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> Arm:
        """Return an arm.

        Raises:
            UnknownName: An option does not exist.
            InvalidSetup: An option is invalid, or the description is that of another arm.
        """
        require_address("Franka arm", address)
        given = FrankaOptions.from_json(options)
        if given.backend == "pylibfranka":
            from rcs.hardware.franka_pylibfranka import PylibfrankaArm

            return PylibfrankaArm(address, about, given)
        return FrankaArm(address, about, given)

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> FrankaHand:
        """Return a hand; it takes no options."""
        require_address("Franka Hand", address)
        require_fields("option of a Franka Hand", options, [])
        return FrankaHand(address, about)


class FrankaArm(StreamedArm):
    """An FR3 under impedance control: torques pull it towards the reference like springs and dampers.

    While it is being switched on, the `mode` of its state is `starting` instead of the controller's own.
    """

    def __init__(self, address: str, about: ArmDescription, options: FrankaOptions | None = None) -> None:
        """Create the arm; `open` connects.

        Args:
            address: Address of the control box.
            about: Description of the arm.
            options: The site's options; None for the defaults.

        Raises:
            InvalidSetup: The description is that of another arm.
        """
        require_fits("franka", about, FR3)
        self._options = FrankaOptions() if options is None else options
        given = self._options.compliance
        self._springs = None if given is None else damped(given, about, FRANKA_HAND)
        super().__init__(
            f"{about.name} at {address}",
            limits_of_fr3(about, speed=self._options.speed, whole_range=self._options.whole_range),
            stream_options(RATE, is_stiff=given is None),
        )
        self._address, self._about = address, about
        self._flange = kinematics_of(about)
        self._franky: Any = None
        self._robot: Any = None
        self._motion: Any = None
        self._newest: Any = None  # state
        self._led: Vector | None = None
        self._has_link = self._is_led = False
        self._problem = ""
        self._seen = (math.nan, 0.0)  # time of the newest state: robot's clock, host's clock

    def _open(self) -> None:
        self._franky = franky = package_of("franka", "franky", "The driver franka needs")
        ignore = franky.RealtimeConfig.Ignore
        self._robot = connected(lambda: franky.Robot(self._address, realtime_config=ignore), self._address, "the arm")
        self._robot.set_collision_behavior(*self._options.thresholds(self._about))
        self._has_link, self._led, self._problem, self._seen = True, None, "", (math.nan, 0.0)

    def _read(self) -> ArmState:
        state = self._fresh_state()
        if self._motion is not None and not self._robot.is_in_control:
            self._problem = self._forget_motion() or "the controller ended the motion without giving a reason"
            until = time.monotonic() + REASON_TIME
            while not fault_of(state, self._about.joints) and time.monotonic() < until:
                time.sleep(1e-3)  # the next state names the joint
                state = self._fresh_state()
        self._problem = fault_of(state, self._about.joints) or self._problem
        if self._problem and not self._is_led and not self.fault:
            self.set_fault(self._problem)
        return ArmState(
            list(state.q),
            list(state.dq),
            time=self._seen[1],
            device_time=self._seen[0],
            commanded_joints=list(state.q if self._led is None else self._led),
            efforts=list(state.tau_J),
            wrench=list(-state.O_F_ext_hat_K),  # the controller reports the force of the arm on its environment
            mode=mode_of(state),
        )

    def _start(self) -> None:
        self._end_motion()
        franky, springs = self._franky, self._springs
        stiffness, damping = (JOINT_STIFFNESS, JOINT_DAMPING) if springs is None else springs.gains
        if springs is None or not springs.is_of_tcp:
            motion = franky.JointImpedanceTrackingMotion(
                stiffness=stiffness, damping=damping, max_delta_tau=TORQUE_STEP
            )
            motion.set_reference(franky.JointReference(q=self._robot.current_joint_positions))
        else:
            posture = franky.PostureTask(self._robot.current_joint_positions, stiffness=POSTURE_STIFFNESS)
            motion = franky.CartesianImpedanceTrackingMotion(posture_task=posture, max_delta_tau=TORQUE_STEP)
            motion.set_gains(franky.CartesianImpedanceGains.diagonal(stiffness, damping))
            motion.set_reference(franky.CartesianReference(target=self._robot.current_pose.end_effector_pose))
        self._begin_motion(motion)
        self._is_led = True

    def _write(self, point: StreamPoint) -> None:
        if self._problem:
            raise DeviceFault(self._problem)
        position, velocity = np.array(point.position), np.array(point.velocity)
        self._led = position
        if self._springs is None or not self._springs.is_of_tcp:
            mass = np.array(self._robot.model.mass(self._newest))
            torques = mass @ np.array(point.acceleration)
            self._motion.set_reference(self._franky.JointReference(q=position, dq=velocity, tau_ff=torques))
            return
        flange, tool_in_flange = self._flange.forward(position).matrix, np.array(self._newest.F_T_EE.matrix)
        twist = self._flange.jacobian(position) @ velocity
        twist[:3] += np.cross(twist[3:], flange[:3, :3] @ tool_in_flange[:3, 3])
        franky = self._franky
        pose, twist = franky.Affine(flange @ tool_in_flange), franky.Twist(twist[:3], twist[3:])
        self._motion.set_reference(franky.CartesianReference(target=pose, target_twist=twist))

    def _stop(self) -> None:
        self._is_led, self._led = False, None
        if self._robot is None or self._motion is None or not self._has_link:
            return
        try:
            within(STOPPING, lambda: self._robot.stop())  # an exception that is kept must not keep the connection
        except TimeoutError as err:
            raise DeviceFault(f"the controller has not confirmed the stop for {STOPPING:g} s") from err
        self._forget_motion()

    def _can_guide(self) -> bool:
        return True

    def _guide(self) -> None:
        self._is_led, self._led = False, None
        self._end_motion()
        motion = self._franky.JointImpedanceTrackingMotion(
            stiffness=[0.0] * 7, damping=GUIDING_DAMPING, max_delta_tau=TORQUE_STEP
        )
        self._begin_motion(motion)

    def _clear(self) -> None:
        if not self._has_link:  # the library cannot reconnect
            self._close()
            self._open()
        self._forget_motion()
        make_idle(self._fresh_state, lambda: self._robot.recover_from_errors(), self._about.joints, pause=1e-3)
        self._problem = ""

    def _close(self) -> None:
        try:
            if self._has_link and self._robot is not None:
                self._end_motion()
        finally:
            let_go = [self._robot, self._motion]
            self._robot = self._newest = self._motion = None
            self._has_link = False
            try:
                within(STOPPING, let_go.clear)  # disconnects; waits for a controller that hangs
            except TimeoutError:
                _log.warning("%s has not disconnected within %g s", self.name, STOPPING)

    def _fresh_state(self) -> Any:
        try:
            state = self._robot.state
        except self._franky.NetworkException as err:
            self._has_link = False
            raise DeviceFault(f"the connection to the controller is lost: {err}. {advice_for(self._address)}") from err
        now, at = time.monotonic(), state.time.to_sec()
        if at != self._seen[0]:
            self._seen = (at, now)
        elif now - self._seen[1] > SILENCE:
            self._has_link = False
            raise DeviceFault(f"the controller has sent no state for {now - self._seen[1]:.2f} s; look at the cable")
        self._newest = state
        return state

    def _begin_motion(self, motion: Any) -> None:
        # By default the library filters the torques once more, at 100 Hz, after limiting their rate. Only 0.4 of the
        # admitted rate then remains, which is too slow for the arm to follow, and it oscillates.
        self._robot.move(motion, asynchronous=True, cutoff_frequency=NO_CUTOFF)
        self._motion = motion

    def _end_motion(self) -> None:
        """Bring the arm to rest by torques and end the motion."""
        if self._motion is not None and self._robot.is_in_control:
            stop = self._franky.TorqueStopMotion(max_duration=STOPPING, max_delta_tau=TORQUE_STEP)
            self._robot.move(stop, asynchronous=True)
        self._forget_motion()

    def _forget_motion(self) -> str:
        """Wait for the end of a motion and return its error, which the next motion would raise otherwise."""
        self._motion = None
        try:
            self._robot.join_motion(2.0 * STOPPING)
        except (self._franky.ControlException, self._franky.NetworkException) as err:
            return str(err)
        return ""
