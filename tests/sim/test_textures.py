from __future__ import annotations

import numpy as np

from rcs.sim import Scene
from rcs.sim.textures import add_textures, procedural_texture, texture_name

MAX_TEXTURES = 16


def test_textures_are_bright_and_all_different() -> None:
    all_of_them = [procedural_texture(i) for i in range(MAX_TEXTURES)]
    assert all(texture.mean() > 128 for texture in all_of_them)
    assert len({texture.tobytes() for texture in all_of_them}) == MAX_TEXTURES


def test_textures_are_in_the_model_as_they_are_computed() -> None:
    scene = Scene.empty()
    add_textures(scene.spec, 3)
    model = scene.compile()
    for i in range(3):
        texture = model.texture(texture_name(i))
        first = int(texture.adr[0])
        pixels = model.tex_data[first : first + 3 * procedural_texture(i).size].reshape(-1, 3)
        np.testing.assert_array_equal(pixels[:, 1], procedural_texture(i).ravel())
        assert texture.id in model.mat_texid[model.material(texture_name(i)).id]
