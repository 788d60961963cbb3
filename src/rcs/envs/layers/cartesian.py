"""Actions that are poses or velocities of the TCP instead of joint positions."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from rcs.envs.layers.layer import ActionSpaces, CopyIndex, Layer, everywhere, renew, replaced
from rcs.envs.spaces import (
    JOINTS,
    TQUAT,
    TWIST,
    XYZRPY,
    Action,
    Observation,
    require_direction,
    tquat_space,
    xyzrpy_space,
)
from rcs.kinematics import IkStatus, Kinematics, VelocityOptions, freedom_of
from rcs.kinematics.chain import POSE
from rcs.spatial import normalize, xyzrpy_to_tquat

ROWS_PER_THREAD = 16
"""A thread takes longer to start than to solve for fewer targets."""


class TcpControl(Layer):
    """Solve for the joints of an arm whose actions are of its TCP, from the last joint target on."""

    memory = ("_joints", "_status")

    def __init__(self, kinematics: Kinematics, threads: int) -> None:
        """Use a solver.

        Args:
            kinematics: Kinematics of the arm with its gripper.
            threads: Largest number of threads that solve for many copies.
        """
        self._kinematics = kinematics
        self._threads = threads
        self._joints: NDArray[np.float64] | None = None
        self._status: NDArray[np.uint8] = np.zeros((), np.uint8)

    def reset(self, observation: Observation, where: CopyIndex = everywhere) -> None:
        """Start from the measured joints."""
        joints = observation[JOINTS]
        nothing = np.zeros(joints.shape[:-1], np.uint8)
        self._status = renew(None if self._joints is None else self._status, nothing, where)
        self._joints = renew(self._joints, joints, where)

    def rebase(self, observation: Observation) -> None:
        """Continue from the measured joints in the next step."""
        self._joints = observation[JOINTS].copy()

    def info(self) -> dict[str, NDArray[Any]]:
        """Return the IkStatus of the last step."""
        return {"ik_status": self._status}

    def threads_for(self, rows: int) -> int:
        """Return the number of threads that solve fastest for a number of targets."""
        return min(self._threads, max(1, rows // ROWS_PER_THREAD))


class CartesianControl(TcpControl):
    """Take `tquat` actions (TCP in the robot's base frame) and pass them on as `joints` by inverse kinematics.

    The solver starts at the last joint target and stays on its branch. A pose out of reach moves the TCP to the nearest
    one that it can reach from there; a pose too far away for one action moves it straight towards it. An arm with fewer
    than six joints meets the translation and leans as it must. `info["ik_status"]` reports it (values of `IkStatus`).
    """

    def __init__(
        self,
        kinematics: Kinematics,
        *,
        preferred: ArrayLike | None = None,
        max_step: ArrayLike | None = None,
        threads: int = 1,
    ) -> None:
        """Use a solver.

        Args:
            kinematics: Kinematics of the arm with its gripper.
            preferred: Joints to which an arm with more than six returns while its TCP moves [rad], shape (dof,); None
                for none: then the elbow drifts.
            max_step: Largest change of each joint per action [rad], shape (dof,); None for no bound.
            threads: Largest number of threads that solve for many copies.
        """
        super().__init__(kinematics, threads)
        self._options = freedom_of(kinematics, best_effort=True, preferred=preferred, max_step=max_step)
        self._leans = kinematics.dof < POSE
        self._solved: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]] | None = None
        """Joints, pose and status of the last `map_action`."""

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Replace `joints` by `tquat`."""
        return replaced(inner, JOINTS, TQUAT, tquat_space())

    def map_action(self, action: Action) -> Action:
        """Solve for the joints.

        Raises:
            InvalidAction: A quaternion has no direction.
        """
        if self._joints is None:
            raise RuntimeError("CartesianControl.map_action was called before reset")
        target = action[TQUAT]
        require_direction(target)
        rows = normalize(target).reshape(-1, 7)
        starts = self._joints.reshape(len(rows), -1)
        threads = self.threads_for(len(rows))
        joints, status, _ = self._kinematics.inverse_batch(rows, starts, self._options, threads)
        solved = joints.reshape(self._joints.shape)
        self._solved = solved, rows.reshape(target.shape), status.reshape(target.shape[:-1])
        return replaced(action, TQUAT, JOINTS, solved)

    def map_executed(self, executed: Action) -> Action:
        """Start the next solve at the executed target, and return its pose."""
        if self._solved is None:
            raise RuntimeError("CartesianControl.map_executed was called before map_action")
        joints = executed[JOINTS]
        solved, pose, self._status = self._solved
        is_elsewhere = (self._status != IkStatus.ok.value) | self._leans
        if joints is not solved:
            is_elsewhere = is_elsewhere | (joints != solved).any(axis=-1)
        if is_elsewhere.any():
            # Copy by copy, since the pose of one must not depend on another's.
            pose = pose.copy()
            pose[is_elsewhere] = self._kinematics.forward_batch(joints[is_elsewhere])
        self._joints = joints
        return replaced(executed, JOINTS, TQUAT, pose)

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return f"CartesianControl(tquat -> joints, {IkStatus.__name__} in info)"


class XyzrpyControl(Layer):
    """Take `xyzrpy` actions and pass them on as `tquat`."""

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Replace `tquat` by `xyzrpy`."""
        return replaced(inner, TQUAT, XYZRPY, xyzrpy_space())

    def map_action(self, action: Action) -> Action:
        """Convert the pose."""
        return replaced(action, XYZRPY, TQUAT, xyzrpy_to_tquat(action[XYZRPY]))


class TwistControl(TcpControl):
    """Take `twist` actions (linear and angular velocity of the TCP in the robot's base frame) and pass on `joints`.

    The target of the last step moves at the twist for one control period, along a straight line and about one axis; so
    zero holds the arm without drift, and a target that is not renewed stands still. Where a joint is as fast as it may
    be, the TCP goes slower, the same way. Near a singular posture and at a joint's limit it goes as it can.
    `info["ik_status"]` reports it (values of `IkStatus`). An arm with fewer than six joints meets the linear velocity
    and leans as it must.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        *,
        frequency: float,
        joint_speed: ArrayLike,
        translation_speed: float = 0.5,
        rotation_speed: float = 2.0,
        preferred: ArrayLike | None = None,
        threads: int = 1,
    ) -> None:
        """Use a solver.

        Args:
            kinematics: Kinematics of the arm with its gripper.
            frequency: Control steps per second [Hz].
            joint_speed: Largest joint speeds [rad/s], a number or shape (dof,).
            translation_speed: Bound of the linear velocity along each axis [m/s].
            rotation_speed: Bound of the angular velocity about each axis [rad/s].
            preferred: Joints to which an arm with more than six returns while its TCP moves [rad], shape (dof,); None
                for none: then the elbow drifts.
            threads: Largest number of threads that solve for many copies.
        """
        super().__init__(kinematics, threads)
        self._period = 1.0 / frequency
        self._bound = np.repeat([float(translation_speed), float(rotation_speed)], 3)
        self._options = VelocityOptions(
            max_velocity=np.broadcast_to(np.asarray(joint_speed, np.float64), (kinematics.dof,)).copy(),
            preferred=np.asarray(preferred, np.float64) if preferred is not None and kinematics.dof > POSE else None,
        )
        self._solved: NDArray[np.uint8] = np.zeros((), np.uint8)
        """Status of the last `map_action`."""

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Replace `joints` by `twist`."""
        own = spaces.Box(-self._bound, self._bound, dtype=np.float64)
        return replaced(inner, JOINTS, TWIST, own)

    def map_action(self, action: Action) -> Action:
        """Move the last target for one period."""
        if self._joints is None:
            raise RuntimeError("TwistControl.map_action was called before reset")
        twists = action[TWIST].reshape(-1, 6)
        starts = self._joints.reshape(len(twists), -1)
        threads = self.threads_for(len(twists))
        joints, status, _ = self._kinematics.advance_batch(starts, twists, self._period, self._options, threads)
        self._solved = status.reshape(self._joints.shape[:-1])
        return replaced(action, TWIST, JOINTS, joints.reshape(self._joints.shape))

    def map_executed(self, executed: Action) -> Action:
        """Move from the executed target next, and return its pose."""
        self._joints = joints = executed[JOINTS]
        self._status = self._solved
        rows = joints.reshape(-1, joints.shape[-1])
        pose = self._kinematics.forward_batch(rows).reshape(*joints.shape[:-1], 7)
        return replaced(executed, JOINTS, TQUAT, pose)

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return f"TwistControl(twist -> joints, {IkStatus.__name__} in info)"
