"""Actions that are velocities of the TCP instead of joint positions."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from rcs.envs.layers.cartesian import TcpControl
from rcs.envs.layers.layer import ActionSpaces, replaced
from rcs.envs.spaces import JOINTS, TQUAT, TWIST, Action
from rcs.kinematics import IkStatus, Kinematics, VelocityOptions
from rcs.kinematics.chain import POSE


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
