"""Converts a target for the TCP into an action for an environment in any control mode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from rcs.envs.layers.keep_tilt import KEPT
from rcs.envs.setup import Setup
from rcs.envs.spaces import GRIPPER, JOINTS, ORIGIN, TQUAT, TWIST, XYZYAW, Action, Observation
from rcs.kinematics import IkStatus, Kinematics, freedom_of
from rcs.spatial import Pose, compose, inverse, limit_step, tquat_to_xyzrpy

MARGIN = 0.9
"""Share of a relative pose action's bounds to use, since a rotation's components differ slightly from its angle."""


class ActionWriter:
    """Writes actions for one environment: joints, poses or twists, absolute or relative, according to its setup.

    Under the layer `KeepTilt`, which tilts the tool itself, it writes the rest of a pose; without an end effector, no
    opening.

    Relative actions count from the target actually reached, or from the origin, which `follow` takes from the step's
    info, since a layer may have limited the one and a hold have moved the other.
    """

    def __init__(
        self, setup: Setup, action_space: spaces.Dict, kinematics: Kinematics, *, preferred: ArrayLike | None = None
    ) -> None:
        """Prepare to write for an environment.

        Args:
            setup: The setup, which has the control mode.
            action_space: Bounds of an action.
            kinematics: Kinematics of the arm with its gripper, for joint actions.
            preferred: Joints to which an arm with more than six returns while its TCP moves [rad], shape (dof,), for
                joint actions; None for none.
        """
        self._name = XYZYAW if XYZYAW in action_space.spaces else setup.control
        box = action_space[self._name]
        assert isinstance(box, spaces.Box)
        self._setup = setup
        self._has_opening = GRIPPER in action_space.spaces
        self._key = JOINTS if setup.control == JOINTS else TQUAT
        self._bound: NDArray[np.float64] = box.high.astype(np.float64)
        self._kinematics = kinematics
        # Stays on the branch of the last target, since a jump to another one would be a large, fast motion.
        self._options = freedom_of(kinematics, best_effort=True, preferred=preferred)
        self.joints = np.zeros(kinematics.dof)
        """The last joint target [rad]."""
        self._last = self._origin = np.zeros(0)

    def reset(self, observation: Observation) -> None:
        """Start from the first observation of an episode."""
        self.joints = np.array(observation[JOINTS])
        self._last = self._origin = np.array(observation[self._key])

    def follow(self, info: Mapping[str, Any], robot: str | None = None) -> None:
        """Continue from the actual target of the last action; without this call, from the intended one.

        Args:
            info: Info of the last step, whose `target` has absolute joints [rad] or the TCP pose; nothing after a
                reset, and after a fault before the first command.
            robot: Name of the robot, if there are several.
        """
        target = info.get("target")
        if target:
            self._last = (target if robot is None else target[robot])[self._key]
        if "refused" in info:  # the devices hold, and an origin moves to where they are
            self._origin = self._last
            return
        self._origin = info.get(ORIGIN if robot is None else f"{robot}/{ORIGIN}", self._origin)

    def write(self, tcp: NDArray[np.float64], opening: float) -> Action | None:
        """Return the action that moves the TCP towards a pose, as far as one step may.

        Args:
            tcp: Translation [m] and quaternion xyzw in the base frame, shape (7,).
            opening: Opening of the gripper, 0 closed … 1 open.

        Returns:
            The action; None if the pose is not feasible.
        """
        if self._setup.control != JOINTS:
            return self._with_gripper(self._pose_action(tcp), opening)
        result = self._kinematics.inverse(Pose.from_tquat(tcp), self.joints, self._options)
        return self.write_joints(result.joints, opening) if result.status == IkStatus.ok else None

    def write_joints(self, joints: NDArray[np.float64], opening: float) -> Action:
        """Return the action that moves the arm towards joints [rad], as far as one step may.

        Args:
            joints: Joint positions [rad], shape (dof,), near the last ones.
            opening: Opening of the gripper, 0 closed … 1 open.
        """
        self.joints = joints
        if self._setup.control != JOINTS:
            return self._with_gripper(self._pose_action(self._kinematics.forward(joints).tquat), opening)
        if self._setup.relative == "origin":
            joints = joints - self._origin
        elif self._setup.relative == "last_step":
            joints = joints - self._last
            joints /= max(1.0, float((np.abs(joints) / self._bound).max()))  # all alike, to keep to the way
            self._last = self._last + joints
        return self._with_gripper(joints, opening)

    def _with_gripper(self, arm: NDArray[np.float64], opening: float) -> Action:
        action: Action = {self._name: arm}
        if self._has_opening:
            action[GRIPPER] = np.array([opening], np.float32)
        return action

    def _pose_action(self, tcp: NDArray[np.float64]) -> NDArray[np.float64]:
        action = tcp
        if self._setup.relative == "origin":
            action = difference(self._origin, tcp)
        elif self._setup.relative == "last_step":
            # The bound of a quaternion's entry is that of the sine of half the angle, that of a twist is per second.
            turn = self._bound[3] if self._setup.control != TQUAT else 2 * np.arcsin(self._bound[3])
            share = MARGIN / self._setup.frequency if self._setup.control == TWIST else MARGIN
            reached = limit_step(self._last, tcp, share * float(self._bound[0]), share * float(turn))
            action = difference(self._last, reached)
            self._last = reached
        if self._setup.control == TQUAT:
            return action
        if self._setup.control == TWIST:
            # A twist turns about one axis, as the shortest way does; roll, pitch and yaw turn about three.
            return self._setup.frequency * np.append(action[:3], Pose.from_tquat(action).rotvec)
        return tquat_to_xyzrpy(action)[KEPT] if self._name == XYZYAW else tquat_to_xyzrpy(action)


def after_hold(info: Mapping[str, Any]) -> dict[str, Any]:
    """Return info without what actions counted from: after `Env.hold`, the next one counts from where devices are.

    Args:
        info: Info of the last step before it.
    """
    return {key: own for key, own in info.items() if key != "target" and key.rpartition("/")[2] != ORIGIN}


def difference(start: NDArray[np.float64], goal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the motion along and about the axes of the parent frame that takes `start` to `goal`, all (7,).

    The last entry of its quaternion is not negative.
    """
    step = compose((0.0, 0.0, 0.0, *goal[3:]), inverse((0.0, 0.0, 0.0, *start[3:])))
    step *= np.sign(step[6]) or 1.0
    step[:3] = goal[:3] - start[:3]
    return step
