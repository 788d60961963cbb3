"""Compare the deflection of compliant arms under a push at the TCP with force over stiffness.

    python benchmarks/compliance.py            # all simulated arms
    python benchmarks/compliance.py --virtual  # and a virtual FR3, through its driver (extra franka): two minutes

Every push is made at home, until the arm stands. `compliance` is the largest part by which a deflection is off. The
last line is the result as JSON.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rcs
from rcs.kinematics import kinematics_of
from rcs.virtual import VirtualProcess

ARMS = ("fr3", "ur5e", "xarm7", "so101")
SETTLED = 5.0
"""Duration of a push [s]."""
TRIES = 8
"""Largest number of interrupted attempts per push."""

Push = Callable[[NDArray[np.float64]], None]


def pushes(robot: str) -> NDArray[np.float64]:
    """Return forces in the frame of the base [N]; those of the SO101 in the plane in which its TCP can move freely."""
    if robot == "so101":
        return np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 0, 1.0], [-0.6, 0, 0.8]])
    return 8.0 * np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0], [0.6, -0.5, 0.6]])


def stand(env: Any, action: dict[str, Any], push: Callable[[], None]) -> NDArray[np.float64]:
    """Return the joint positions after `SETTLED` seconds [rad].

    Raises:
        TimeoutError: The episode has ended early, because the machine is too busy for real time.
    """
    joints = action["joints"]
    for _ in range(round(SETTLED * env.frequency)):
        push()
        observation, _, _, truncated, info = env.step(action)
        if truncated:
            raise TimeoutError(info["faults"])
        joints = observation["joints"]
    return joints


def moved_by(env: Any, force: NDArray[np.float64], push: Push) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the joints before a push and in it [rad]; one that breaks off is made again."""
    for _ in range(TRIES):
        push(np.zeros(3))
        observation, _ = env.reset()
        action = {key: observation[key] for key in env.action_space}
        try:
            before = stand(env, action, lambda: push(np.zeros(3)))
            return before, stand(env, action, lambda: push(force))
        except TimeoutError:
            env.recover()
    raise TimeoutError(f"the machine is too busy: {TRIES} tries have failed")


def off(env: Any, robot: str, compliance: rcs.Compliance, push: Push) -> float:
    """Return the largest part by which a deflection is not force over stiffness."""
    placement = env.robots[robot]
    kinematics, worst = kinematics_of(placement.arm, placement.end_effector), 0.0
    for force in pushes(robot):
        before, here = moved_by(env, force, push)
        stiffness = np.array(compliance.gains[0])
        if compliance.is_of_tcp:
            moved = np.array(kinematics.forward(here).translation) - kinematics.forward(before).translation
            expected = force / stiffness[:3]
        else:
            moved, expected = here - before, kinematics.jacobian(here)[:3].T @ force / stiffness
        worst = max(worst, float(np.linalg.norm(moved - expected) / np.linalg.norm(expected)))
    return round(worst, 4)


def simulated(env: Any) -> Push:
    """Return a function that pushes the TCP of a simulated arm."""
    robot = env.simulation.robots[0]
    data, site = robot.world.data, robot.layout.tcp_site
    body = robot.world.model.site_bodyid[site]

    def push(force: NDArray[np.float64]) -> None:
        force = data.xmat[robot.layout.base_body].reshape(3, 3) @ force
        data.xfrc_applied[body] = [*force, *np.cross(data.site_xpos[site] - data.xipos[body], force)]

    return push


def told(virtual: VirtualProcess) -> Push:
    """Return a function that sends changed pushes to a virtual robot."""
    last = [np.zeros(3)]

    def push(force: NDArray[np.float64]) -> None:
        if (force != last[0]).any():
            virtual.tell("push", *force)
        last[0] = force

    return push


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--virtual", action="store_true", help="a virtual FR3, too")
    result: dict[str, float] = {}
    options: dict[str, Any] = {"relative": "absolute", "max_episode_steps": None, "collision_reaction": False}
    is_virtual = parser.parse_args().virtual
    for name in (*ARMS, "virtual fr3")[: None if is_virtual else -1]:
        robot = name.split()[-1]
        share = 0.1 if robot == "so101" else 1.0
        for kind in ("joints", "tcp"):
            given: Any = {"joints": 200.0 * share} if kind == "joints" else {"tcp": (1000.0 * share, 60.0 * share)}
            options |= {"robot": robot, "compliance": rcs.Compliance(**given)}
            if name in ARMS:
                with rcs.make("Free", **options) as env:
                    setup: Any = env.robots[robot].compliance
                    result[f"{name}/{kind}"] = off(env, robot, setup, simulated(env))
            else:
                with VirtualProcess(robot) as virtual, rcs.make("Free", hardware=virtual.site, **options) as env:
                    setup = env.robots[robot].compliance
                    result[f"{name}/{kind}"] = off(env, robot, setup, told(virtual))
    print(json.dumps({"benchmark": "compliance", **result, "compliance": max(result.values())}))


if __name__ == "__main__":
    main()
