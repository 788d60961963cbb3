"""PickCuboid of this project: `rcs_pick.py [pixels]`, 32 copies with joint actions, or 24 with a camera of 84 px."""

from __future__ import annotations

import sys

from rate import report

import rcs


def main() -> None:
    """Measure and print."""
    size = int(sys.argv[1])
    look = {"cameras": rcs.Cameras(names=("side",), image_size=size, pixels=rcs.Pixels())} if size else {}
    copies = 24 if size else 32
    envs = rcs.make_vec(
        "PickCuboid", copies=copies, threads=2, observe=("privileged",), collision_reaction=False, **look
    )
    envs.reset(seed=0)
    envs.action_space.seed(0)
    actions = [envs.action_space.sample() for _ in range(100)]
    turn = 0

    def step() -> None:
        nonlocal turn
        envs.step(actions[turn % len(actions)])
        turn += 1

    physics = float(envs.simulation.world.model.opt.timestep)
    report(step, copies=copies, control_period=1 / envs.frequency, physics_step=physics, pixels=size)


if __name__ == "__main__":
    main()
