"""Measure complete steps of `make_vec` with a camera in every copy, in the format of learners: channels first.

Random joint actions; actions checked and mapped, physics, drawing, observations, reward, autoreset. In the same run, in
turns: the same steps without cameras, and the drawing of all copies alone. The frames of every copy must be new in each
step.

Prints one JSON object: `steps_per_s` (of all copies together), `best_steps_per_s` (the fastest round),
`without_cameras_per_s`, `frames_per_s` (drawing alone), `drawn_by`. For two cores, run it as
`taskset -c 0,1 python benchmarks/pixels.py`.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

import rcs
from rcs._core import PixelCameras
from rcs.envs.ports.simulated import PixelPort
from rcs.envs.vector import VecEnv
from rcs.sim.pixels import Pixels


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    task: str = "PickCuboid"
    """The task."""
    robot: str = "fr3"
    """The robot."""
    copies: int = 24
    """Copies of the environment."""
    size: int = 64
    """Edge length of the square frames [px]."""
    cameras: tuple[str, ...] = ("side",)
    """Cameras of each copy."""
    grayscale: bool = False
    """Use one channel instead of three."""
    stack: int = 1
    """Number of frames in an observation."""
    threads: int = 0
    """Threads; 0 for one per CPU that the process may use."""
    steps: int = 40
    """Steps of all copies in a round."""
    rounds: int = 15
    """Rounds; the median counts."""
    save: Path | None = None
    """Folder for pictures of the first copies (PNG)."""


def main(options: Options) -> None:
    """Measure and print."""
    pixels = Pixels(grayscale=options.grayscale, stack=options.stack, valid_steps=2)
    threads = options.threads or len(os.sched_getaffinity(0))
    common: dict[str, Any] = {"robot": options.robot, "collision_reaction": False}
    size = {"copies": options.copies, "threads": threads}
    drawn = rcs.make_vec(
        options.task,
        cameras=rcs.Cameras(names=options.cameras, image_size=options.size, pixels=pixels),
        **size,
        **common,
    )
    blind = rcs.make_vec(options.task, **size, **common)
    actions = random_actions(drawn, options.steps)
    drawn.reset(seed=0)
    blind.reset(seed=0)
    check_frames(drawn, actions, options.cameras)
    steps_of(drawn, actions), steps_of(blind, actions)
    feed = next(port for port in drawn.stack.ports if isinstance(port, PixelPort)).feed
    cores = [group.core for group in feed._groups if group.core is not None]
    world, again = drawn.simulation.world.core, np.full(options.copies, PixelCameras.REPLACE, np.uint8)
    whole, without, frames = [], [], []
    for _ in range(options.rounds):
        whole.append(options.copies * options.steps / steps_of(drawn, actions))
        without.append(options.copies * options.steps / steps_of(blind, actions))
        begin = time.perf_counter()
        for _ in range(options.steps):
            for core in cores:
                core.show(world, again)
        frames.append(options.copies * len(options.cameras) * options.steps / (time.perf_counter() - begin))
    if options.save is not None:
        save(options.save, drawn, actions, options)
    why = cores[0].why_opengl
    drawn.close()
    blind.close()
    print(
        json.dumps(
            {
                "benchmark": "pixels",
                "steps_per_s": round(median(whole)),
                "best_steps_per_s": round(max(whole)),
                "without_cameras_per_s": round(median(without)),
                "frames_per_s": round(median(frames)),
                "size": options.size,
                "copies": options.copies,
                "cameras": list(options.cameras),
                "layout": ["copies", "channels", "height", "width"],
                "channels": pixels.channels,
                "threads": threads,
                "drawn_by": f"OpenGL: {why}" if why else "rcs",
            }
        )
    )


def random_actions(envs: VecEnv, steps: int) -> list[dict[str, NDArray[Any]]]:
    """Return actions of all copies for each step."""
    rng = np.random.default_rng(0)
    spaces: Any = envs.single_action_space
    low, high = spaces["joints"].low, spaces["joints"].high
    return [
        {
            "joints": rng.uniform(0.2 * low, 0.2 * high, (envs.num_envs, len(low))),
            "gripper": rng.uniform(0, 1, (envs.num_envs, 1)).astype(np.float32),
        }
        for _ in range(steps)
    ]


def steps_of(envs: VecEnv, actions: list[dict[str, NDArray[Any]]]) -> float:
    """Return how long steps take [s]."""
    begin = time.perf_counter()
    for action in actions:
        envs.step(action)
    return time.perf_counter() - begin


def check_frames(envs: VecEnv, actions: list[dict[str, NDArray[Any]]], cameras: tuple[str, ...]) -> None:
    """Check that each copy's newest frame is another one in every step."""
    before: dict[str, NDArray[Any]] = {}
    for action in actions[:20]:
        observation = envs.step(action)[0]
        for camera in cameras:
            now = observation["frames"][camera]["pixels"]
            if camera in before:
                is_new = (now != before[camera]).reshape(len(now), -1).any(axis=-1)
                assert is_new.all(), f"copies {np.flatnonzero(~is_new)} show the same as in the step before"
            before[camera] = now.copy()


def save(folder: Path, envs: VecEnv, actions: list[dict[str, NDArray[Any]]], options: Options) -> None:
    """Save the newest frames of four copies side by side."""
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    observation = envs.step(actions[0])[0]
    for camera in options.cameras:
        stacks = observation["frames"][camera]["pixels"][:4]
        newest = stacks[:, -(1 if options.grayscale else 3) :]
        picture = np.concatenate(list(np.moveaxis(newest, 1, -1)), axis=1)
        name = folder / f"{options.robot}-{options.task}-{camera}-{options.size}.png"
        Image.fromarray(np.broadcast_to(picture, (*picture.shape[:2], 3)).copy()).save(name)


if __name__ == "__main__":
    main(tyro.cli(Options))
