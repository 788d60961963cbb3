"""`rcs ik`: joints for a pose of the TCP."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from numpy.typing import NDArray
from rcs_data.cli.console import plain_console
from rcs_data.convert.png import encode_png
from rcs_data.output import require_writable
from rich.console import Console
from rich.table import Table

import rcs
from rcs.cli.runs import pose_of
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.kinematics import Backend, Elbow, IkOptions, IkResult, IkStatus, Kinematics, freedom_of, kinematics_of
from rcs.kinematics.chain import POSE
from rcs.robots.description import ArmDescription
from rcs.setups.make import resolve
from rcs.sim.scene import RobotPlacement

LEFT = IkOptions()
"""What may be left of a pose that is met."""


@dataclass(kw_only=True)
class IkCommand:
    """Show joints that bring a robot's TCP to a pose. Exit code 1 if there are none.

    The tool of an arm with fewer than six joints leans where it cannot turn: the nearest joints are shown, with exit
    code 1.
    """

    robot: tyro.conf.Positional[str]
    """Name of a robot with one arm."""
    pose: tuple[float, float, float, float, float, float]
    """Where the TCP shall be, in the base frame: x y z [m], roll pitch yaw [rad] about the fixed axes."""
    start: tuple[float, ...] | None = None
    """Joints to look from [rad], one per joint; home if left out."""
    elbow: float | None = None
    """Angle of the elbow of an arm with seven joints [rad]; 0 is up."""
    nearest: bool = False
    """Go from the start as near as it gets, instead of looking for any solution."""
    end_effector: str | None = None
    """Name of the gripper or hand; the robot's usual one if left out, `none` for the flange."""
    backend: Backend = "mujoco"
    """Who computes; `pinocchio` is an extra."""
    seed: int = 0
    """Of the random starts of the search."""
    picture: Path | None = None
    """Draw the robot with these joints into this PNG file."""

    def run(self) -> int:
        """Solve and print."""
        if self.picture is not None:
            require_writable(self.picture, is_file=True)
        setup = Setup(task="Free", robot=self.robot, end_effector=self.end_effector)
        robots = resolve(setup).robots
        if len(robots) != 1:
            arms = ", ".join(sorted({robot.arm.name for robot in robots}))
            raise InvalidSetup(f"{self.robot!r} has {len(robots)} arms; inverse kinematics is of one: {arms}.")
        robot = robots[0]
        start = np.array(robot.arm.home if self.start is None else self.start)
        if start.shape != (robot.arm.dof,):
            raise InvalidSetup(f"--start has {len(start)} numbers; {robot.arm.label} has {robot.arm.dof} joints.")
        _check_start(robot.arm, start)
        if self.elbow is not None and not math.isfinite(self.elbow):
            raise InvalidSetup(f"--elbow is {self.elbow}; valid is a finite number.")
        kinematics = kinematics_of(robot.arm, robot.end_effector, backend=self.backend)
        found = _judged(self._solve(kinematics, start))
        console = plain_console()
        if found.status == IkStatus.infeasible:
            console.print("status: infeasible")
            console.print("No joints that bring the TCP there were found; --nearest shows how near it gets.")
            return 1
        _print(console, robot, kinematics, found)
        if self.picture is not None:
            self.picture.parent.mkdir(parents=True, exist_ok=True)
            self.picture.write_bytes(encode_png(_drawn(setup, found.joints)))
            console.print(f"Picture: {self.picture}")
        return 1 if found.status == IkStatus.nearest else 0

    def _solve(self, kinematics: Kinematics, start: NDArray[np.float64]) -> IkResult:
        target = pose_of(self.pose)
        if self.nearest:
            options = freedom_of(kinematics, best_effort=True)
        elif kinematics.dof < POSE:
            # First exactly, then as control by poses does it: the tool leans.
            exact = kinematics.inverse(target, start, IkOptions(seed=self.seed))
            if exact.status == IkStatus.ok:
                return exact
            options = freedom_of(kinematics, restarts=60)
        else:
            options = IkOptions(seed=self.seed)
        if self.elbow is not None:
            return Elbow(kinematics).inverse(target, start, self.elbow, options)
        return kinematics.inverse(target, start, options)


def _check_start(arm: ArmDescription, start: NDArray[np.float64]) -> None:
    for name, value, lower, upper in zip(arm.joints, start, arm.joint_lower, arm.joint_upper, strict=True):
        if not lower <= value <= upper:
            raise InvalidSetup(f"--start: {name} is {value}; valid is {lower:.3f} .. {upper:.3f} rad.")


def _judged(found: IkResult) -> IkResult:
    """Return a result as `nearest` where more is left of the pose than `ok` allows, as of a tool that leans."""
    is_met = found.translation_error <= LEFT.translation_tolerance and found.rotation_error <= LEFT.rotation_tolerance
    if found.status != IkStatus.ok or is_met:
        return found
    errors = (found.translation_error, found.rotation_error, found.iterations)
    return IkResult(found.joints.tolist(), IkStatus.nearest, *errors)


def _print(console: Console, robot: RobotPlacement, kinematics: Kinematics, found: IkResult) -> None:
    table = Table("joint", "rad", "degrees", "limits [rad]", box=None, pad_edge=False)
    limits = zip(robot.arm.joints, found.joints, kinematics.joint_lower, kinematics.joint_upper, strict=True)
    for name, value, lower, upper in limits:
        table.add_row(name, f"{value:.6f}", f"{np.rad2deg(value):.2f}", f"{lower:.3f} .. {upper:.3f}")
    console.print(table)
    console.print(f"status: {found.status.name}")
    console.print(f"residual: {1e3 * found.translation_error:.4f} mm, {1e3 * found.rotation_error:.4f} mrad")
    if kinematics.dof == len(robot.arm.joints) == 7:
        console.print(f"elbow: {Elbow(kinematics).angle(found.joints):.4f} rad")


def _drawn(setup: Setup, joints: NDArray[np.float64]) -> NDArray[np.uint8]:
    env = rcs.make(setup, render_mode="rgb_array")
    try:
        env.reset(options={"robot": {"joints": joints}})
        return env.render()
    finally:
        env.close()
