"""Actions that are TCP poses instead of joint positions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.layers.layer import ActionSpaces, Layer, Where, everywhere, renew
from rcs.envs.spaces import JOINTS, MINIMAL_NORM, TQUAT, Action, Observation, tquat_space
from rcs.errors import InvalidAction
from rcs.kinematics import DampedLeastSquares, IkOptions, IkStatus
from rcs.spatial import normalize


class CartesianControl(Layer):
    """Take `tquat` actions (TCP in the robot's base frame) and pass them on as `joints` by inverse kinematics.

    The solver starts at the last joint target and stays on its branch. An unreachable pose keeps the last target;
    `info["ik_status"]` reports it (values of `IkStatus`).
    """

    memory = ("_joints", "_status")

    def __init__(self, kinematics: DampedLeastSquares, *, max_step: float = np.inf) -> None:
        """Use a solver.

        Args:
            kinematics: Of the arm with its gripper.
            max_step: Largest change of any joint per action [rad]; targets farther away are clamped.
        """
        self._kinematics = kinematics
        self._options = IkOptions(max_step=max_step, restarts=0, iterations=50)
        self._joints: NDArray[np.float64] | None = None
        self._solved: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]] | None = None
        """Joints, pose and status of the last `map_action`."""
        self._status: NDArray[np.uint8] = np.zeros((), np.uint8)

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Replace `joints` by `tquat`."""
        return {
            (TQUAT if key == JOINTS else key): (tquat_space() if key == JOINTS else box) for key, box in inner.items()
        }

    def reset(self, observation: Observation, where: Where = everywhere) -> None:
        """Start from the measured joints."""
        joints = observation[JOINTS]
        nothing = np.zeros(joints.shape[:-1], np.uint8)
        self._status = renew(None if self._joints is None else self._status, nothing, where)
        self._joints = renew(self._joints, joints, where)

    def rebase(self, observation: Observation) -> None:
        """Start the next solve at the measured joints."""
        self._joints = observation[JOINTS].copy()

    def map_action(self, action: Action) -> Action:
        """Solve for the joints.

        Raises:
            InvalidAction: A quaternion has no direction.
        """
        if self._joints is None:
            raise RuntimeError("CartesianControl.map_action was called before reset")
        target = action[TQUAT]
        norms = np.sqrt((target[..., 3:] ** 2).sum(axis=-1))
        if (norms < MINIMAL_NORM).any():
            raise InvalidAction(
                f"The quaternion of {TQUAT!r} has norm {norms.min():.3g}; valid is a unit quaternion xyzw."
            )
        rows = normalize(target).reshape(-1, 7)
        starts = self._joints.reshape(len(rows), -1)
        joints, status = self._kinematics.inverse_batch(rows, starts, self._options)
        solved = joints.reshape(self._joints.shape)
        self._solved = solved, rows.reshape(target.shape), status.reshape(target.shape[:-1])
        mapped: Action = {(JOINTS if key == TQUAT else key): value for key, value in action.items()}
        mapped[JOINTS] = solved
        return mapped

    def map_executed(self, executed: Action) -> Action:
        """Start the next solve at the executed target, and return its pose."""
        if self._solved is None:
            raise RuntimeError("CartesianControl.map_executed was called before map_action")
        joints = executed[JOINTS]
        solved, pose, self._status = self._solved
        is_elsewhere = self._status != 0
        if joints is not solved:
            is_elsewhere = is_elsewhere | (joints != solved).any(axis=-1)
        if is_elsewhere.any():
            # Copy by copy, since the pose of one must not depend on another's.
            pose = pose.copy()
            pose[is_elsewhere] = self._kinematics.forward_batch(joints[is_elsewhere])
        self._joints = joints
        return {
            (TQUAT if key == JOINTS else key): (pose if key == JOINTS else value) for key, value in executed.items()
        }

    def info(self) -> dict[str, NDArray[Any]]:
        """Return the IkStatus of the last solve."""
        return {"ik_status": self._status}

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return f"CartesianControl(tquat -> joints, {IkStatus.__name__} in info)"
