"""Procedural textures for surfaces, computed so that no images need to be shipped."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

EDGE = 128
"""Width and height of a texture [px]."""
WOOD = "wood"
"""Name of the wooden material and its texture."""
WOOD_EDGE = 512
"""Width and height of the picture of wood [px]."""
BOARDS = 6
"""Boards of a table top."""
REPEAT = 2.0
"""How often it repeats on a surface."""


def add_textures(spec: mujoco.MjSpec, count: int) -> None:
    """Add materials with textures to a scene; `texture_name` has their names.

    They are bright grey, so that a surface keeps its colour.
    """
    for number in range(count):
        name = texture_name(number)
        grey = procedural_texture(number)
        texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=EDGE, height=EDGE, nchannel=3)
        texture.data = np.repeat(grey[..., None], 3, axis=-1).tobytes()
        material = spec.add_material(name=name, texrepeat=[REPEAT, REPEAT], specular=0.2, shininess=0.3)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def add_wood(spec: mujoco.MjSpec) -> str:
    """Add a material like the top of a wooden table and return its name."""
    texture = spec.add_texture(
        name=WOOD, type=mujoco.mjtTexture.mjTEXTURE_2D, width=WOOD_EDGE, height=WOOD_EDGE, nchannel=3
    )
    texture.data = wood().tobytes()
    material = spec.add_material(name=WOOD, specular=0.15, shininess=0.3)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = WOOD
    return WOOD


def wood() -> NDArray[np.uint8]:
    """Return the picture of boards with grain, (WOOD_EDGE, WOOD_EDGE, 3), grey so that a surface keeps its colour."""
    rng = np.random.default_rng(7)
    x, y = np.meshgrid(np.arange(WOOD_EDGE) / WOOD_EDGE, np.arange(WOOD_EDGE) / WOOD_EDGE)
    board = np.floor(BOARDS * y).astype(int)
    tone = rng.uniform(0.86, 1.0, BOARDS)[board]
    phase = rng.uniform(0.0, 1.0, BOARDS)[board]
    # Growth rings: lines along the board that wander slowly across it.
    wander = 0.35 * np.sin(2 * np.pi * (1.3 * x + phase)) + 0.15 * np.sin(2 * np.pi * (3.1 * x + 2 * phase))
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (9.0 * (BOARDS * y) + 1.5 * wander + 5 * phase))
    fibre = np.repeat(rng.random((WOOD_EDGE, WOOD_EDGE // 32)), 32, axis=1)
    gap = np.where((BOARDS * y) % 1.0 < 0.02, 0.72, 1.0)
    value = tone * gap * (0.88 + 0.09 * rings + 0.05 * fibre)
    return np.repeat(np.rint(255 * np.clip(value, 0.0, 1.0)).astype(np.uint8)[..., None], 3, axis=-1)


def texture_name(number: int) -> str:
    """Return the name of a texture and its material."""
    return f"texture {number}"


def procedural_texture(number: int) -> NDArray[np.uint8]:
    """Return the grey values of a texture, (EDGE, EDGE): wood, checks, stripes or cloth, of changing scale.

    All tile without seams.
    """
    rng = np.random.default_rng(number)
    x, y = np.meshgrid(np.arange(EDGE) / EDGE, np.arange(EDGE) / EDGE)
    scale = 2 * (1 + number // 4)
    kind = number % 4
    if kind == 0:
        wave = 0.5 * np.sin(2 * np.pi * (2 * x + y)) + 0.25 * np.sin(2 * np.pi * 3 * x)
        value = 0.5 + 0.5 * np.sin(2 * np.pi * (4 * scale * y + wave))
    elif kind == 1:
        value = ((np.floor(2 * scale * x) + np.floor(2 * scale * y)) % 2).astype(np.float64)
    elif kind == 2:
        value = 0.5 + 0.5 * np.sign(np.sin(2 * np.pi * 2 * scale * (x + y)))
    else:
        value = 0.5 + 0.25 * (np.sin(2 * np.pi * 8 * scale * x) + np.sin(2 * np.pi * 8 * scale * y))
    grain = rng.random((EDGE, EDGE))
    return np.rint(255 * (0.55 + 0.35 * value + 0.10 * grain)).astype(np.uint8)
