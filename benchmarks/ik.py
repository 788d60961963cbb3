"""Inverse kinematics of the FR3 on random reachable targets, checked independently.

Targets are the forward kinematics of joint vectors drawn uniformly inside the limits; every solve starts at home. Each
answer is put into a model of its own and compared with its target; the reference time is one evaluation of MuJoCo's
kinematics and Jacobian, in the same run.

Prints one JSON object: `solved` (of 1000), `violations` (answers outside the joint limits), `median_us`.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass

import mujoco
import numpy as np
import tyro

from rcs.devices import lookup
from rcs.kinematics import IkOptions, IkStatus, attach_end_effector, kinematics_of, load
from rcs.spatial import Pose


@dataclass(kw_only=True)
class Options:
    """What to measure."""

    targets: int = 1000
    """Number of targets."""
    seed: int = 0
    """Of the targets."""


def main(options: Options) -> None:
    """Measure and print."""
    arm, gripper = lookup.find("arm", "fr3"), lookup.find("gripper", "franka_hand")
    solver = kinematics_of(arm, gripper)
    lower, upper = np.array(arm.joint_lower), np.array(arm.joint_upper)
    home = np.array(arm.home)
    joints = np.random.default_rng(options.seed).uniform(lower, upper, (options.targets, arm.dof))

    # A model of its own for targets and checks, so that the solver is not its own judge.
    spec = load(arm)
    attach_end_effector(spec, arm, gripper)
    model = spec.compile()
    data = mujoco.MjData(model)
    tcp, base = model.site("gripper/tcp").id, model.body(arm.base_body).id
    assert base == 1 and not model.body_pos[base].any(), "the base frame is the world frame in this check"

    def forward(q: np.ndarray) -> Pose:
        data.qpos[: arm.dof] = q
        mujoco.mj_kinematics(model, data)
        matrix = np.eye(4)
        matrix[:3, :3] = data.site_xmat[tcp].reshape(3, 3)
        matrix[:3, 3] = data.site_xpos[tcp]
        return Pose.from_matrix(matrix)

    targets = [forward(q) for q in joints]
    settings = IkOptions()
    for target in targets[:20]:
        solver.inverse(target, home, settings)
    times, solved, violations, worst = [], 0, 0, (0.0, 0.0)
    for target in targets:
        begin = time.perf_counter()
        result = solver.inverse(target, home, settings)
        times.append(time.perf_counter() - begin)
        answer = result.joints
        violations += bool((answer < lower).any() or (answer > upper).any())
        reached = forward(answer)
        errors = reached.distance_to(target), reached.angle_to(target)
        is_solved = errors[0] <= 1.01e-4 and errors[1] <= 1.01e-4
        solved += is_solved
        assert is_solved == (result.status == IkStatus.ok), "the status does not say what the answer is"
        if is_solved:
            worst = max(worst[0], errors[0]), max(worst[1], errors[1])
    begin = time.perf_counter()
    jacobian = np.zeros((6, model.nv))
    for q in joints:
        forward_only(model, data, q, jacobian, tcp)
    reference = (time.perf_counter() - begin) / len(joints)
    print(
        json.dumps(
            {
                "benchmark": "ik",
                "solved": int(solved),
                "targets": options.targets,
                "violations": int(violations),
                "median_us": round(1e6 * float(np.median(times)), 2),
                "mean_us": round(1e6 * float(np.mean(times)), 1),
                "p99_us": round(1e6 * float(np.quantile(times, 0.99)), 1),
                "worst_mm": round(1e3 * worst[0], 4),
                "worst_mrad": round(1e3 * worst[1], 4),
                "one_jacobian_from_python_us": round(1e6 * reference, 2),
            }
        )
    )


def forward_only(model: mujoco.MjModel, data: mujoco.MjData, q: np.ndarray, jacobian: np.ndarray, site: int) -> None:
    """Evaluate MuJoCo's kinematics and Jacobian once."""
    data.qpos[: len(q)] = q
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)


if __name__ == "__main__":
    main(tyro.cli(Options))
