"""The tip of a closed gripper or hand, as something to push with."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs.control_layers import GRASP
from rcs.kinematics import load
from rcs.robots import GripperDescription, HandDescription
from rcs.spatial import Pose

LENGTH = 0.03
"""Length of the tip [m]: about the height of what is pushed."""


@dataclass(frozen=True, kw_only=True)
class Tip:
    """The box around the tip, in the TCP's frame."""

    middle: tuple[float, float, float]
    """Middle of the face at its end [m]."""
    half: tuple[float, float]
    """Half its extents along x and y [m]."""

    @staticmethod
    def of(effector: GripperDescription | HandDescription) -> Tip:
        """Measure the shapes that collide, of a gripper closed on nothing or a hand in a power grasp."""
        model = load(effector).compile()
        data = mujoco.MjData(model)
        for name, value in zip(effector.joints, _closed(effector), strict=True):
            data.joint(name).qpos = value
        mujoco.mj_kinematics(model, data)
        tcp = data.site(effector.tcp_site)
        solid = np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
        corners = np.concatenate([_corners(model, data, int(geom)) for geom in solid])
        corners = (corners - tcp.xpos) @ tcp.xmat.reshape(3, 3)
        end = corners[:, 2].max()
        sides = corners[corners[:, 2] > end - LENGTH, :2]
        low, high = sides.min(axis=0), sides.max(axis=0)
        x, y = ((low + high) / 2).tolist()
        half_x, half_y = ((high - low) / 2).tolist()
        return Tip(middle=(x, y, float(end)), half=(half_x, half_y))

    @property
    def radius(self) -> float:
        """Radius of the circle around it [m]."""
        return float(np.hypot(*self.half))

    def place(self, tcp: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return its middle for a pose of the TCP (7,), in the same frame: x, y, and its lowest z [m], (3,)."""
        rotation = Pose.from_tquat(tcp).matrix[:3, :3]
        middle = tcp[:3] + rotation @ np.array(self.middle)
        middle[2] -= np.abs(rotation[2, :2]) @ np.array(self.half)
        return middle


def _closed(effector: GripperDescription | HandDescription) -> NDArray[np.float64]:
    if isinstance(effector, GripperDescription):
        return np.array(effector.joint_closed)
    low, high = np.array(effector.joint_lower), np.array(effector.joint_upper)
    return low + np.array(effector.grasps[GRASP]) * (high - low)


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> NDArray[np.float64]:
    """Return the corners of the box around a geom, (8, 3) [m]."""
    center, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    return data.geom_xpos[geom] + (center + signs * half) @ data.geom_xmat[geom].reshape(3, 3).T
