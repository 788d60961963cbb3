"""Serve a policy, run it by its address, and compare executions under latency: open loop, receding, blended.

The policy is a script that observes only states and returns chunks: targets of the gripper for the next 0.8 s. It
replaces a learned policy, which is served in the same way from an environment of its own.
"""

from __future__ import annotations

import argparse

import numpy as np
from vlagents import Metadata, Observation, PartSpec, Server
from vlagents.policies.scripted import ScriptedPolicy

import rcs
from rcs.policy import Execution, ServedPolicy, fitted
from rcs.rollout import Evaluation, Summary, evaluate
from rcs.spatial import distance, limit_step, tquat_to_matrix

RATE, HORIZON = 20.0, 16  # rows per second [Hz], and of a chunk
SPEED, TURN_SPEED = 0.25, 1.5
"""Speed of the TCP's translation [m/s] and rotation [rad/s]."""


def chunk(seen: Observation, instruction: str) -> np.ndarray:
    """Return the next rows of a pick: pose of the TCP [m, xyzw] and opening of the gripper."""
    tcp, cuboid = seen.state["tquat"], seen.state["privileged/cuboid/tquat"]
    is_held, opening = bool(seen.state["is_grasped"][0]), float(seen.state["gripper"][0])
    short_edge = tquat_to_matrix(cuboid)[:2, 1]
    yaw = np.arctan2(-short_edge[0], short_edge[1])
    yaw = (yaw + np.pi / 2) % np.pi - np.pi / 2  # the pads are symmetric under half a turn
    down = [np.cos(yaw / 2), np.sin(yaw / 2), 0.0, 0.0]
    rows, closing = [], 0.3 if opening < 0.9 else 0.0
    for _ in range(HORIZON):
        aside = float(np.hypot(*(cuboid[:2] - tcp[:2])))
        turned = float(distance(tcp, np.array([*tcp[:3], *down]))[1])
        is_there = aside < 0.015 and abs(tcp[2] - cuboid[2]) < 0.012
        is_held |= closing > 0.6
        closing = closing + 1.0 / RATE if is_there or is_held else 0.0
        # Down a funnel: the further the gripper is aside or turned away, the higher it stays.
        above = 0.0 if closing else min(0.15, 5.0 * max(aside - 0.008, 0.0) + 0.3 * max(turned - 0.1, 0.0))
        goal = np.array([*cuboid[:2], cuboid[2] + above, *down])
        if is_held:
            goal[:3] = tcp[0], tcp[1], 0.35
        tcp = limit_step(tcp, goal, SPEED / RATE, TURN_SPEED / RATE)
        rows.append([*tcp, 0.0 if closing else 1.0])
    return np.array(rows)


METADATA = Metadata(
    name="scripted pick",
    state=(
        PartSpec("tquat", 7, "m, xyzw"),
        PartSpec("gripper", 1, "0 closed, 1 open"),
        PartSpec("is_grasped", 1),
        PartSpec("privileged/cuboid/tquat", 7, "m, xyzw"),
    ),
    action=(PartSpec("tquat", 7, "m, xyzw"), PartSpec("gripper", 1, "0 closed, 1 open")),
    horizon=HORIZON,
    rate=RATE,
)


def policy() -> ScriptedPolicy:
    """Return the policy, as `vlagents serve 16_policy:policy` does."""
    return ScriptedPolicy(chunk, METADATA)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--latencies", type=float, nargs="+", default=[0.0, 0.1, 0.3])
    given = parser.parse_args()
    setup = fitted(rcs.Setup(task="PickCuboid", robot="fr3"), METADATA)
    with Server(policy(), port=0) as server:
        for latency in given.latencies:
            for mode in ("open_loop", "receding", "ensemble", "rtc"):
                served = ServedPolicy(address=str(server.address), execution=Execution(mode=mode, latency=latency))
                summary = Summary()
                for _ in evaluate(Evaluation(setup=setup, agent=served, episodes=given.episodes), summary):
                    pass
                low, high = (100 * bound for bound in summary.interval)
                steps = np.mean([result.steps for result in summary.results])
                print(
                    f"latency {latency:.1f} s, {mode:9}: {summary.successes:3} of {summary.judged} "
                    f"({low:3.0f} to {high:3.0f} %), {steps / setup.frequency:4.1f} s an episode"
                )
