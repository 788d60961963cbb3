"""The network interface of a Franka Research 3 and its hand: the vendor's FCI, version 10.

The arm listens on TCP port 1337 and sends its state by UDP every millisecond; a client that moves the arm answers each
state with a command. The arm stops for all reasons that the vendor documents: commands beyond the limits of the
interface, too much force, 20 lost packets in a row, the user stop. It then brakes and stays in the mode "reflex" until
a client recovers it. Impedances for the built-in controllers are accepted but have no effect, since the simulated
servos have their own.
"""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.sim.loads import SimLoads
from rcs.spatial import Pose
from rcs.virtual.fault import Fault
from rcs.virtual.franka_client import Client, Listener
from rcs.virtual.franka_forces import ExternalForces
from rcs.virtual.franka_generators import MotionGenerator, motion_errors, torque_errors
from rcs.virtual.franka_hand_wire import FrankaHandWire
from rcs.virtual.franka_messages import (
    ARM_COMMAND,
    ARM_HEADER,
    ARM_PORT,
    ARM_STATE,
    ARM_VERSION,
    REQUESTS,
    Command,
    Controller,
    Error,
    GeneratorMode,
    Mode,
    MoveStatus,
    columns,
)
from rcs.virtual.franka_model import Carried, urdf_of
from rcs.virtual.virtual_robot import VirtualRobot
from rcs.virtual.wire import Wire

MOST_LOST = 20
"""Largest number of commands missing in a row; one more stops the arm (vendor's FCI documentation)."""
FINISH_SPEED = 0.05
"""Joint speed above which a motion may not end [rad/s]; our choice."""

_DONE, _NOT_POSSIBLE, _INVALID = 0, 1, 2
Vector = NDArray[np.float64]


class FrankaWire(Wire):
    """Implements the interface of an arm and its hand, if it has one."""

    rate: ClassVar[int] = 1000
    address: ClassVar[str] = "127.0.0.1"
    faults: ClassVar[Mapping[str, str]] = {
        "reflex": "",
        "user_stop": "",
        "brakes": "",
        "code": "N",
        "version": "N",
    }

    def __init__(self, robot: VirtualRobot, address: str) -> None:
        """Listen on the arm's port, and on the hand's if it has one."""
        self.robot = robot
        self._address = address
        self._arm = robot.about
        self._kinematics = kinematics_of(robot.about, robot.gripper)
        self._carried = Carried.of(robot.gripper)
        self._urdf = urdf_of(robot.about).encode()
        self._forces = ExternalForces(SimLoads(robot.body))
        self._listener = Listener(robot.line, address, ARM_PORT, ARM_HEADER, REQUESTS)
        self._hand = FrankaHandWire(robot, address, self._listener) if robot.gripper is not None else None
        self._version = ARM_VERSION
        self._is_stopped_by_user = self._is_braked = False
        self._errors: set[Error] = set()
        self._reasons: set[Error] = set()  # why the last motion ended
        self._pose_k_in_ee = Pose()
        self._pose_ee_in_ne = Pose()
        self._load = (0.0, np.zeros(3), np.zeros(9))
        self._forget_motion()
        self._torques = np.zeros(7)
        self._rest(Mode.IDLE)
        model = robot.body.world.model  # the controller measures torques behind the gears and compensates friction
        model.dof_frictionloss[model.jnt_dofadr[robot.body.layout.joint_ids]] = 0.0
        self._received = deque([1.0] * 100, maxlen=100)
        self._state = np.zeros((), ARM_STATE)
        self._write_mounting()

    def site(self) -> Mapping[str, Mapping[str, Any]]:
        """Return the site entries of the arm and the hand."""
        entry = {"driver": "franka", "address": self._address}
        return {"arms": entry} if self._hand is None else {"arms": entry, "grippers": entry}

    def files(self) -> Sequence[Any]:
        """Return the sockets to read from."""
        return [*self._listener.files(), *(self._hand.files() if self._hand is not None else ())]

    def receive(self, file: socket.socket) -> None:
        """Process requests and commands."""
        if self._hand is not None and file in self._hand.files():
            self._hand.receive(file)
            return
        had_client = self._listener.client is not None
        for command, number, request in self._listener.receive(file, ARM_COMMAND):
            self._answer(self._listener.client, command, number, request)
        if had_client and self._listener.client is None:
            self._leave()

    def tick(self, robot: VirtualRobot) -> None:
        """Move the arm for a millisecond, monitor it, and send its state."""
        self._forces.measure(self._kinematics.jacobian(robot.joints))
        client = self._listener.client
        if self._mode is Mode.MOVE and client is not None:
            self._move(client.take_datagram())
        if self._mode is Mode.MOVE:
            if errors := [*motion_errors(self._arm, robot.joints, robot.velocities), *self._forces.collisions()]:
                self._abort(MoveStatus.REFLEX_ABORTED, errors)
        elif self._mode in (Mode.IDLE, Mode.GUIDING):
            robot.lead(self._joints)
        if client is not None and client.is_connected:
            client.send_datagram(self._write_state(client).tobytes())
        if self._hand is not None:
            self._hand.tick()

    def tell(self, fault: Fault) -> None:
        """Apply a fault: a collision, the user stop, locked brakes, an error code, or another version."""
        if fault.name == "reflex":
            self._forces.collided[3] = 1.0  # like a push against the forearm
            self._abort(MoveStatus.REFLEX_ABORTED, [Error.JOINT_REFLEX])
        elif fault.name == "code":
            if fault.number not in list(Error):
                raise InvalidSetup(f"The code is {fault.value}; valid are 0 to {max(Error)}.")
            self._abort(MoveStatus.REFLEX_ABORTED, [Error(int(fault.number))])
        elif fault.name == "version":
            self._version = fault.whole(0xFFFF)
            self._listener.hang_up()
            self._leave()
        else:
            self._is_stopped_by_user |= fault.name == "user_stop"
            self._is_braked |= fault.name == "brakes"
            self._end_motion(MoveStatus.EMERGENCY_ABORTED)
            self.robot.brake()
            self._mode = Mode.USER_STOPPED if self._is_stopped_by_user else Mode.OTHER

    def clear(self) -> None:
        """Release the user stop and the brakes, and restore the usual version."""
        self._version = ARM_VERSION
        if self._is_stopped_by_user or self._is_braked:
            self._is_stopped_by_user = self._is_braked = False
            self._rest(Mode.REFLEX if self._errors else Mode.IDLE)

    def close(self) -> None:
        """Stop listening."""
        self._listener.close()
        if self._hand is not None:
            self._hand.close()

    # --- Requests ---

    def _answer(self, client: Client | None, command: int, number: int, request: Any) -> None:
        if client is None:
            return
        self.robot.note("request", command=Command(command).name if command in list(Command) else command)
        reply = client.reply
        if command == Command.CONNECT:
            fits = int(request["version"]) == self._version
            reply(command, number, bytes([0 if fits else 1]) + self._version.to_bytes(2, "little"))
            if fits:
                client.connect(int(request["udp_port"]))
        elif command == Command.GET_ROBOT_MODEL:
            reply(command, number, bytes([_DONE]) + self._urdf)
        elif command == Command.MOVE:
            self._begin(client, number, request)
        elif command == Command.STOP_MOVE:
            reply(command, number, bytes([self._stop()]))
        elif command == Command.AUTOMATIC_ERROR_RECOVERY:
            reply(command, number, bytes([self._recover()]))
        elif command in REQUESTS:
            reply(command, number, bytes([self._set(command, request)]))

    def _set(self, command: int, request: Any) -> int:
        values = np.concatenate([np.ravel(request[name]) for name in request.dtype.names])
        if self._mode is not Mode.IDLE and command != Command.SET_COLLISION_BEHAVIOR:
            return _NOT_POSSIBLE
        if not np.isfinite(values).all():
            return _INVALID
        if command == Command.SET_COLLISION_BEHAVIOR:
            if (values < 0).any():
                return _INVALID
            self._forces.set_thresholds(request)
        elif command == Command.SET_JOINT_IMPEDANCE:
            return _DONE if (values >= 0).all() and (values <= 14250).all() else _INVALID
        elif command == Command.SET_CARTESIAN_IMPEDANCE:
            most = np.repeat([3000.0, 300.0], 3)
            return _DONE if (values >= np.repeat([10.0, 1.0], 3)).all() and (values <= most).all() else _INVALID
        elif command in (Command.SET_EE_TO_K, Command.SET_NE_TO_EE):
            pose = Pose.from_matrix(values.reshape(4, 4).T)
            if command == Command.SET_EE_TO_K:
                self._pose_k_in_ee = pose
            else:
                self._pose_ee_in_ne = pose
        elif command == Command.SET_LOAD:
            if request["mass"] < 0:
                return _INVALID
            self._load = (float(request["mass"]), np.array(request["center"]), np.array(request["inertia"]))
        self._write_mounting()
        return _DONE

    def _begin(self, client: Client, number: int, request: Any) -> None:
        controller, generator = int(request["controller_mode"]), int(request["motion_generator_mode"]) + 1
        if self._mode is not Mode.IDLE:
            client.reply(Command.MOVE, number, bytes([MoveStatus.NOT_POSSIBLE]))
            return
        if controller > Controller.EXTERNAL or generator > GeneratorMode.NONE:
            client.reply(Command.MOVE, number, bytes([MoveStatus.INVALID_ARGUMENT]))
            return
        is_torque = generator == GeneratorMode.NONE
        if is_torque != (controller == Controller.EXTERNAL) or request["use_async_motion_generator"]:
            # Torques together with a motion generator, and the controller's own planning, are not simulated.
            client.reply(Command.MOVE, number, bytes([MoveStatus.INVALID_ARGUMENT]))
            return
        self._forget_motion()
        self._motion = number
        self._mode = Mode.MOVE
        self._generator_mode, self._controller_mode = GeneratorMode(generator), Controller(controller)
        if not is_torque:
            self._generator = MotionGenerator(self._generator_mode, self._arm, self._kinematics, self._joints)
        self._errors.clear()
        self._reasons.clear()
        self._torques = np.zeros(7)
        client.take_datagram()
        client.reply(Command.MOVE, number, bytes([MoveStatus.MOTION_STARTED]))

    def _stop(self) -> int:
        if self._mode is not Mode.MOVE:
            return _NOT_POSSIBLE if self._mode is not Mode.IDLE else _DONE
        self._end_motion(MoveStatus.PREEMPTED)
        self._rest(Mode.IDLE)
        return _DONE

    def _recover(self) -> int:
        if self._mode not in (Mode.IDLE, Mode.REFLEX):
            return _NOT_POSSIBLE
        self._errors.clear()
        self._forces.forget_collisions()
        self._rest(Mode.IDLE)
        return _DONE

    def _leave(self) -> None:
        """Brake after the client has disconnected, as the arm does for a silent client."""
        if self._mode is Mode.MOVE:
            self._abort(MoveStatus.REFLEX_ABORTED, [Error.COMMUNICATION_CONSTRAINTS_VIOLATION])

    # --- Motions ---

    def _move(self, datagram: bytes | None) -> None:
        command = None
        if datagram is not None and len(datagram) == ARM_COMMAND.itemsize:
            command = np.frombuffer(datagram, ARM_COMMAND)[0]
            if int(command["message_id"]) <= self._answered:
                command = None
        if command is None:
            self._miss()
            return
        number = int(command["message_id"])
        ticks = 1 if self._answered < 0 else number - self._answered
        self._answered, self._lost = number, 0
        self._received.append(1.0)
        if self._generator is None:
            torques = np.array(command["tau_J_d"])
            self.robot.log_point(torques=torques)
            if not np.isfinite(torques).all():
                self._abort(MoveStatus.INPUT_ERROR_ABORTED, [Error.TAU_J_RANGE_VIOLATION])
                return
            # A client computes from the last torques it has received, which may be two commands old.
            if errors := torque_errors(self._arm, torques, self._torques, ticks + 1):
                self._abort(MoveStatus.REFLEX_ABORTED, errors)
                return
            self._torques = torques
            self.robot.push(torques)
            if command["torque_command_finished"]:
                self._finish(self.robot.velocities)
            return
        errors = self._generator.take(command, ticks)
        self.robot.log_point(joints=self._generator.joints)
        if errors:
            self._abort(MoveStatus.REFLEX_ABORTED, errors)
            return
        self._lead(self._generator)
        if command["motion_generation_finished"]:
            self._finish(self._generator.velocities)

    def _miss(self) -> None:
        client = self._listener.client
        if self._answered < 0 or client is None:
            return
        if self._generator is not None:
            self._generator.extrapolate()
            self._lead(self._generator)
        if client.had_time:
            self._lost += 1
            self._received.append(0.0)
            if self._lost > MOST_LOST:
                self._abort(MoveStatus.REFLEX_ABORTED, [Error.COMMUNICATION_CONSTRAINTS_VIOLATION])

    def _lead(self, generator: MotionGenerator) -> None:
        self._joints, self._pose = generator.joints, generator.pose
        self.robot.lead(generator.joints, generator.velocities, generator.accelerations)

    def _finish(self, velocities: Vector) -> None:
        if np.abs(velocities).max() > FINISH_SPEED and self._generator is not None:
            self._abort(MoveStatus.REFLEX_ABORTED, [Error.JOINT_MOTION_GENERATOR_ACCELERATION_DISCONTINUITY])
            return
        self._end_motion(MoveStatus.SUCCESS)
        self._rest(Mode.IDLE)

    def _abort(self, status: MoveStatus, errors: Sequence[Error]) -> None:
        """Brake and report errors."""
        self.robot.note("reflex", errors=[error.name.lower() for error in errors])
        self._errors |= set(errors)
        self._reasons = set(errors)
        self._end_motion(status)
        self._mode = Mode.REFLEX
        self.robot.brake()

    def _end_motion(self, status: MoveStatus) -> None:
        if self._motion is not None and self._listener.client is not None:
            self._listener.client.reply(Command.MOVE, self._motion, bytes([status]))
        self._forget_motion()

    def _forget_motion(self) -> None:
        self._motion: int | None = None
        self._generator: MotionGenerator | None = None
        self._generator_mode, self._controller_mode = GeneratorMode.IDLE, Controller.OTHER
        self._answered, self._lost = -1, 0

    def _rest(self, mode: Mode) -> None:
        """Hold the present position from now on."""
        self._mode = mode
        self.robot.rest()
        self._joints = self.robot.joints  # the reference
        self._pose = self._kinematics.forward(self._joints)

    # --- Senses ---

    def _write_mounting(self) -> None:
        """Write the fields of the state that only settings change."""
        state, carried = self._state, self._carried
        state["F_T_NE"] = columns(carried.pose_tcp_in_flange)
        state["NE_T_EE"] = columns(self._pose_ee_in_ne)
        state["F_T_EE"] = columns(carried.pose_tcp_in_flange * self._pose_ee_in_ne)
        state["EE_T_K"] = columns(self._pose_k_in_ee)
        state["m_ee"], state["F_x_Cee"], state["I_ee"] = carried.mass, carried.center, carried.inertia.ravel()
        state["m_load"], state["F_x_Cload"], state["I_load"] = self._load
        state["O_ddP_O"] = (0.0, 0.0, -9.81)

    def _write_state(self, client: Client) -> NDArray[np.void]:
        robot, state = self.robot, self._state
        joints, velocities = robot.joints, robot.velocities
        generator = self._generator
        pose = Pose.from_tquat(robot.pose_tcp_in_base)
        led, pose_led = self._joints, self._pose
        if self._mode is not Mode.IDLE and generator is None:
            led, pose_led = joints, pose  # torques and brakes have no reference
        matrix = columns(pose)
        client.sent += 1
        state["message_id"] = client.sent
        state["O_T_EE"] = matrix if self._pose_ee_in_ne == Pose() else columns(pose * self._pose_ee_in_ne)
        state["O_T_EE_d"] = state["O_T_EE_c"] = columns(pose_led)
        state["elbow"] = (joints[2], -1.0 if joints[3] < 0 else 1.0)
        state["elbow_d"] = state["elbow_c"] = (led[2], -1.0 if led[3] < 0 else 1.0)
        state["q"] = state["theta"] = joints
        state["dq"] = state["dtheta"] = velocities
        state["q_d"] = led
        state["dq_d"] = 0.0 if generator is None else generator.velocities
        state["ddq_d"] = 0.0 if generator is None else generator.accelerations
        if generator is not None:
            state["O_dP_EE_c"] = state["O_dP_EE_d"] = self._kinematics.jacobian(led) @ generator.velocities
        else:
            state["O_dP_EE_c"] = state["O_dP_EE_d"] = 0.0
        state["tau_J"] = robot.torques
        state["tau_J_d"] = self._torques if self._controller_mode is Controller.EXTERNAL else 0.0
        self._forces.write(state, pose)
        state["motion_generator_mode"], state["controller_mode"] = self._generator_mode, self._controller_mode
        state["errors"], state["reflex_reason"] = 0, 0
        state["errors"][list(self._errors)] = 1
        state["reflex_reason"][list(self._reasons)] = 1
        state["robot_mode"] = self._mode
        state["control_command_success_rate"] = np.mean(self._received) if self._mode is Mode.MOVE else 0.0
        return state
