"""Render the animations of the documentation: the scripted expert of every task on every robot with an id for it.

python tools/moving_pictures.py [NAME ...]    # writes docs/img/NAME.webp; all without a name
"""

from __future__ import annotations

import sys
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

import rcs
from rcs.agents import agent_for
from rcs.sim.viewer import Picture

FOLDER = Path(__file__).parents[1] / "docs" / "img"
SIZE = (384, 288)
"""Width and height of a picture [px]."""
OVERSAMPLING = 2
"""Pictures are drawn this many times larger, and scaled down: smooth edges compress better, too."""
RATE = 15
"""Pictures per second."""
FREQUENCY = 30.0
"""Control steps per second [Hz]."""
PAUSE = 0.7
"""Duration of the last picture [s]."""
SHOWN = {
    "pick_cuboid_fr3": ("PickCuboid", "fr3", 3),
    "pick_cuboid_ur5e": ("PickCuboid", "ur5e", 1),
    "pick_cuboid_so101": ("PickCuboid", "so101", 2),
    "pick_toy_xarm7": ("PickToy", "xarm7", 1),
    "lift_bar_dual_fr3": ("LiftBar", "dual_fr3", 1),
    "place_ur5e": ("Place", "ur5e", 1),
    "stack_fr3": ("StackCuboid", "fr3", 1),
    "push_so101": ("Push", "so101", 1),
}
"""Task, robot and seed by the file's name."""


def episode(task: str, robot: str, seed: int) -> list[NDArray[np.uint8]]:
    """Return pictures of the expert at work."""
    env = rcs.make(task, robot=robot, frequency=FREQUENCY)
    width, height = (OVERSAMPLING * edge for edge in SIZE)
    picture = Picture(env.simulation.world, size=(width, height), quality="full")
    pictures: list[NDArray[np.uint8]] = []
    steps = 0

    def look() -> None:
        nonlocal steps
        if steps % round(FREQUENCY / RATE) == 0:
            pictures.append(picture.draw())
        steps += 1

    result = rcs.run_episode(env, agent_for(env), seed=seed, on_step=look)
    picture.close()
    env.close()
    if not result.success:
        raise RuntimeError(f"{task} on {robot} with seed {seed} failed: {result.failure}.")
    return [*pictures, *pictures[-1:] * round(PAUSE * RATE)]


def write(path: Path, pictures: list[NDArray[np.uint8]]) -> None:
    """Write pictures as an animated WebP that repeats without end."""
    with av.open(str(path), "w", format="webp", options={"loop": "0"}) as container:
        options = {"quality": "80", "compression_level": "6", "preset": "picture"}
        stream = container.add_stream("libwebp_anim", rate=RATE, options=options)
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuv420p"
        stream.time_base = Fraction(1, RATE)
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(*SIZE, "yuv420p", interpolation="AREA")
            frame.pts, frame.time_base = number, Fraction(1, RATE)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


for name in sys.argv[1:] or SHOWN:
    FOLDER.mkdir(parents=True, exist_ok=True)
    write(FOLDER / f"{name}.webp", episode(*SHOWN[name]))
    print(f"{name}.webp: {(FOLDER / f'{name}.webp').stat().st_size / 1000:.0f} kB")
