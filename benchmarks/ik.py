"""Test inverse kinematics on random poses, with an independent check.

Reachable targets are the forward kinematics of joint vectors drawn uniformly inside the limits; every solve starts at
home. So the orientation asked of an arm with five joints is one that it can take, too. Each answer is put into a model
of its own and compared with its target; the reference time is one evaluation of MuJoCo's kinematics and Jacobian, in
the same run. Where Pinocchio is installed (the extra `pinocchio`), its backend solves the same targets.

Wild targets are mostly out of reach, and starts mostly at limits and in singular postures: there, with a bounded step,
and for velocities, what counts is that answers are finite, inside the limits and the bound, and have a status.

Prints one JSON object last: per robot and backend `solved` (of `targets`), `violations` (answers outside the joint
limits), `median_us`; per robot `wild`.
"""

from __future__ import annotations

import importlib.util
import json
import time
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import tyro

from rcs.devices import lookup
from rcs.kinematics import (
    Backend,
    IkOptions,
    IkStatus,
    Kinematics,
    VelocityOptions,
    attach_end_effector,
    freedom_of,
    kinematics_of,
    load,
)
from rcs.kinematics.chain import POSE
from rcs.spatial import Pose, normalize, wxyz_to_xyzw

GRIPPERS = {"fr3": "franka_hand", "xarm7": "robotiq_2f85", "ur5e": "robotiq_2f85", "so101": "so101_gripper"}


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    robot: str = "fr3"
    """Name of an arm, or `all`."""
    targets: int = 1000
    """Number of reachable targets."""
    wild: int = 100_000
    """Number of targets that are mostly out of reach, and of twists."""
    pinocchio_targets: int = 1000
    """How many of the targets Pinocchio solves, if it is installed; it takes longer."""
    threads: int = 1
    """Threads for the wild targets, whose time is not measured."""
    seed: int = 0
    """Random seed of the targets."""


class Judge:
    """A model of its own for targets and checks, so that no solver is its own judge."""

    def __init__(self, arm: Any, gripper: Any) -> None:
        spec = load(arm)
        attach_end_effector(spec, arm, gripper)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.addresses = [int(self.model.joint(name).qposadr[0]) for name in arm.joints]
        self.tcp, base = self.model.site(f"gripper/{gripper.tcp_site}").id, self.model.body(arm.base_body).id
        mujoco.mj_kinematics(self.model, self.data)
        self.base = Pose(self.data.xpos[base], wxyz_to_xyzw(self.data.xquat[base])).inverse()
        self.jacobian = np.zeros((6, self.model.nv))

    def forward(self, q: Any) -> Pose:
        """Return the TCP's pose in the base frame."""
        self.data.qpos[self.addresses] = q
        mujoco.mj_kinematics(self.model, self.data)
        matrix = np.eye(4)
        matrix[:3, :3] = self.data.site_xmat[self.tcp].reshape(3, 3)
        matrix[:3, 3] = self.data.site_xpos[self.tcp]
        return self.base * Pose.from_matrix(matrix)

    def reference(self, joints: Any) -> float:
        """Return the time of one evaluation of MuJoCo's kinematics and Jacobian [s]."""
        begin = time.perf_counter()
        for q in joints:
            self.data.qpos[self.addresses] = q
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_comPos(self.model, self.data)
            mujoco.mj_jacSite(self.model, self.data, self.jacobian[:3], self.jacobian[3:], self.tcp)
        return (time.perf_counter() - begin) / len(joints)


def reachable(arm: Any, solver: Kinematics, judge: Judge, targets: list[Pose]) -> dict[str, Any]:
    """Solve reachable targets from home."""
    home = np.array(arm.home)
    lower, upper = np.array(arm.joint_lower), np.array(arm.joint_upper)
    settings = IkOptions()
    most = 1.01 * settings.translation_tolerance, 1.01 * settings.rotation_tolerance
    for target in targets[:20]:
        solver.inverse(target, home, settings)
    times, solved, violations, worst = [], 0, 0, (0.0, 0.0)
    for target in targets:
        begin = time.perf_counter()
        result = solver.inverse(target, home, settings)
        times.append(time.perf_counter() - begin)
        answer = result.joints
        violations += bool((answer < lower).any() or (answer > upper).any())
        reached = judge.forward(answer)
        errors = reached.distance_to(target), reached.angle_to(target)
        is_solved = errors[0] <= most[0] and errors[1] <= most[1]
        solved += is_solved
        assert is_solved == (result.status == IkStatus.ok), "the status does not match the answer"
        if is_solved:
            worst = max(worst[0], errors[0]), max(worst[1], errors[1])
    return {
        "solved": int(solved),
        "targets": len(targets),
        "solved_fraction": round(solved / len(targets), 4),
        "violations": int(violations),
        "median_us": round(1e6 * float(np.median(times)), 2),
        "mean_us": round(1e6 * float(np.mean(times)), 1),
        "p99_us": round(1e6 * float(np.quantile(times, 0.99)), 1),
        "worst_mm": round(1e3 * worst[0], 4),
        "worst_mrad": round(1e3 * worst[1], 4),
    }


def wild(arm: Any, solver: Kinematics, options: Options) -> dict[str, Any]:
    """Ask for poses far and near, and for velocities slow and fast, from bad postures; count what is not in order."""
    rng = np.random.default_rng(options.seed + 1)
    lower, upper, count = solver.joint_lower, solver.joint_upper, options.wild
    starts = rng.uniform(lower, upper, (count, arm.dof))
    at_limits = rng.random(starts.shape) < 0.3
    starts[::3] = np.where(at_limits[::3], np.where(starts < 0.5 * (lower + upper), lower, upper)[::3], starts[::3])
    straight = rng.random(starts.shape) < 0.5  # joints at 0 line axes up, and stretch most arms
    starts[1::3] = np.where(straight[1::3], np.clip(0.0, lower, upper), starts[1::3])
    targets = np.empty((count, 7))
    targets[:, :3] = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-2, 2, (count, 1))
    targets[:, 3:] = rng.normal(size=(count, 4))
    near = rng.random(count) < 0.2
    targets[near] = solver.forward_batch(starts)[near]
    targets[near, :3] += rng.normal(size=(int(near.sum()), 3)) * 0.01
    targets = normalize(targets)
    twists = rng.normal(size=(count, 6)) * 10.0 ** rng.uniform(-6, 2, (count, 1))
    period = 1 / 30
    bound = np.array(arm.velocity_limit) * period
    follow = freedom_of(solver, best_effort=True, preferred=arm.home, max_step=bound)
    search = freedom_of(solver, restarts=1, max_step=bound)
    velocity = VelocityOptions(
        max_velocity=np.array(arm.velocity_limit), preferred=np.array(arm.home) if arm.dof > POSE else None
    )
    answers = {
        "followed": solver.inverse_batch(targets, starts, follow, options.threads),
        "searched": solver.inverse_batch(targets, starts, search, options.threads),
        "twists": solver.advance_batch(starts, twists, period, velocity, options.threads),
    }
    counted: dict[str, Any] = {"targets": count}
    valid = [status.value for status in IkStatus]
    for name, (joints, status, errors) in answers.items():
        counted[name] = {
            "not_finite": int((~np.isfinite(joints)).any(axis=-1).sum() + (~np.isfinite(errors)).any(axis=-1).sum()),
            "outside_limits": int(((joints < lower) | (joints > upper)).any(axis=-1).sum()),
            "beyond_bound": int((np.abs(joints - starts) > bound * (1 + 1e-9)).any(axis=-1).sum()),
            "without_status": int((~np.isin(status, valid)).sum()),
            **{one.name: int((status == one.value).sum()) for one in IkStatus},
        }
    return counted


def main(options: Options) -> None:
    """Measure and print."""
    found: dict[str, Any] = {}
    for name in GRIPPERS if options.robot == "all" else [options.robot]:
        arm: Any = lookup.find("arm", name)
        gripper: Any = lookup.find("gripper", GRIPPERS.get(name, "robotiq_2f85"))
        judge = Judge(arm, gripper)
        joints = np.random.default_rng(options.seed).uniform(
            arm.joint_lower, arm.joint_upper, (options.targets, arm.dof)
        )
        targets = [judge.forward(q) for q in joints]
        found[name] = {"mujoco": reachable(arm, kinematics_of(arm, gripper), judge, targets)}
        if importlib.util.find_spec("pinocchio") is not None and options.pinocchio_targets > 0:
            backend: Backend = "pinocchio"
            other = kinematics_of(arm, gripper, backend=backend)
            found[name][backend] = reachable(arm, other, judge, targets[: options.pinocchio_targets])
        found[name]["one_jacobian_from_python_us"] = round(1e6 * judge.reference(joints), 2)
        found[name]["wild"] = wild(arm, kinematics_of(arm, gripper), options)
        print(f"{name}: {found[name]}", flush=True)
    print(json.dumps({"benchmark": "ik", "robots": found}))


if __name__ == "__main__":
    main(tyro.cli(Options))
