"""A Franka controller's estimates of external forces, and its thresholds for contacts and collisions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.sim.loads import SimLoads
from rcs.spatial import Pose
from rcs.virtual.franka_messages import Error

LOAD_FILTER = 0.05
"""Weight of the newest external force in the filtered one, a low-pass of about 8 Hz; our choice."""
CONTACT, COLLISION = 0, 1
"""Rows of the arrays of thresholds."""
REGIMES = ("acceleration", "nominal")
"""The regimes of the vendor's thresholds; the larger ones count."""

Vector = NDArray[np.float64]


class ExternalForces:
    """Filtered joint torques and TCP wrench that the arm exerts on its environment."""

    def __init__(self, loads: SimLoads) -> None:
        """Start without forces and without thresholds.

        Args:
            loads: Loads on the simulated arm.
        """
        self._loads = loads
        self._torques, self._wrench = np.zeros(7), np.zeros(6)
        self._torque_thresholds, self._force_thresholds = np.full((2, 7), np.inf), np.full((2, 6), np.inf)
        self.collided, self._collided_tool = np.zeros(7), np.zeros(6)
        """1 for each joint that has collided since the last recovery, else 0, shape (7,)."""

    def measure(self, jacobian: Vector) -> None:
        """Filter the present measurement.

        Args:
            jacobian: Jacobian of the TCP in the base, shape (6, 7).
        """
        tool = self._loads.tcp_wrench  # on the arm; the controller reports the opposite
        self._wrench += LOAD_FILTER * (-tool - self._wrench)
        self._torques += LOAD_FILTER * (-jacobian.T @ tool - self._torques)

    def set_thresholds(self, request: Any) -> None:
        """Set the thresholds of a `SetCollisionBehavior` request [N·m, N]."""
        for row, bound in ((CONTACT, "lower"), (COLLISION, "upper")):
            self._torque_thresholds[row] = np.max([request[f"{bound}_torque_{name}"] for name in REGIMES], axis=0)
            self._force_thresholds[row] = np.max([request[f"{bound}_force_{name}"] for name in REGIMES], axis=0)

    def collisions(self) -> list[Error]:
        """Return errors for forces above the upper thresholds and store the collisions."""
        joints = np.abs(self._torques) > self._torque_thresholds[COLLISION]
        tool = np.abs(self._wrench) > self._force_thresholds[COLLISION]
        self.collided = np.maximum(self.collided, joints)
        self._collided_tool = np.maximum(self._collided_tool, tool)
        return [Error.JOINT_REFLEX] * bool(joints.any()) + [Error.CARTESIAN_REFLEX] * bool(tool.any())

    def forget_collisions(self) -> None:
        """Clear the stored collisions."""
        self.collided[:] = self._collided_tool[:] = 0.0

    def write(self, state: NDArray[np.void], pose: Pose) -> None:
        """Write forces, contacts and collisions into a state of the controller.

        Args:
            state: Message of the vendor's robot state.
            pose: Pose of the TCP in the base.
        """
        turn = pose.matrix[:3, :3].T
        state["tau_ext_hat_filtered"] = self._torques
        state["O_F_ext_hat_K"] = self._wrench
        state["K_F_ext_hat_K"] = np.concatenate([turn @ self._wrench[:3], turn @ self._wrench[3:]])
        state["joint_contact"] = np.abs(self._torques) > self._torque_thresholds[CONTACT]
        state["cartesian_contact"] = np.abs(self._wrench) > self._force_thresholds[CONTACT]
        state["joint_collision"], state["cartesian_collision"] = self.collided, self._collided_tool
