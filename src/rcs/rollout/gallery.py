"""A page of pictures: every environment, drawn in both qualities, with what its cameras see."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import simplejpeg
from numpy.typing import NDArray
from rcs_data.view import pictures_page

from rcs.agents import agent_for
from rcs.envs.assemble import assemble
from rcs.envs.cameras import Cameras
from rcs.envs.env import Env
from rcs.envs.setup import Setup
from rcs.errors import DatasetError
from rcs.setups.ids import ids
from rcs.setups.make import make, resolve
from rcs.sim.camera import Quality
from rcs.sim.viewer import Picture

SIZE = (960, 720)
"""Size of a picture [px]."""
JPEG_QUALITY = 92
STEPS = 45
"""Steps of the expert before the picture: half the motion to the object."""


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One picture of the gallery."""

    group: str
    """Task and robot."""
    title: str
    file: Path


def gallery(out: Path, *, seed: int = 0) -> Iterator[Shot]:
    """Draw every registered environment and write the page `index.html`, yielding every picture as it is written.

    Args:
        out: Folder for the pictures.
        seed: Seed of the episodes.

    Raises:
        DatasetError: The folder cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        shots: list[Shot] = []
        for name, (task, robot) in ids().items():
            if task == "Free":
                continue  # the same robot without its task
            for shot in _shots(name, task, robot, out, seed):
                shots.append(shot)
                yield shot
        groups: dict[str, list[tuple[str, str]]] = {}
        for shot in shots:
            groups.setdefault(shot.group, []).append((shot.title, shot.file.name))
        (out / "index.html").write_text(pictures_page("Gallery", groups), "utf-8")
    except OSError as err:
        raise DatasetError(f"The gallery cannot be written to {out}: {err}") from err


def _shots(name: str, task: str, robot: str, out: Path, seed: int) -> Iterator[Shot]:
    group = f"{task}, {robot}"
    stem = name.removeprefix("rcs/").removesuffix("-v0")
    for quality in get_args(Quality):
        setup = Setup(task=task, robot=robot, cameras=Cameras("all", image_size=(320, 240)), render_quality=quality)
        env = make(setup)
        try:
            _go_on(env, setup, seed)
            picture = Picture(env.simulation.world, size=SIZE, quality=quality)
            yield _write(group, f"scene, {quality}", picture.draw(), out / f"{stem}-{quality}.jpg")
            picture.close()
            frames = env.stack.lift(env.stack.measure())["frames"]
            for camera, frame in frames.items():
                title = f"camera {camera}, {quality}"
                yield _write(group, title, frame["rgb"], out / f"{stem}-camera-{camera}-{quality}.jpg")
        finally:
            env.close()


def _go_on(env: Env, setup: Setup, seed: int) -> None:
    """Start an episode and let the expert act for a while, without drawing what it does not look at."""
    blind = assemble(resolve(setup), is_blind=True)
    observation, info = blind.reset(seed=seed)
    expert = agent_for(blind)
    expert.reset(observation, info)
    for _ in range(STEPS):
        observation, _, terminated, truncated, info = blind.step(expert.act(observation, info))
        if terminated or truncated:
            break
    env.reset(seed=seed, options={"state": blind.simulation.world.states()})
    blind.close()


def _write(group: str, title: str, picture: NDArray[np.uint8], file: Path) -> Shot:
    file.write_bytes(
        simplejpeg.encode_jpeg(np.ascontiguousarray(picture), quality=JPEG_QUALITY, colorsubsampling="444")
    )
    return Shot(group=group, title=title, file=file)
