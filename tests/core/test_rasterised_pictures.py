"""Colours that a renderer draws without OpenGL look as OpenGL draws them, and depend on nothing drawn before."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from rcs import _core
from rcs.sim import World
from tests.core.drawn_scene import SCENE, Image, MakeRenderer, build, draw


def colours(renderer: _core.Renderer, data: mujoco.MjData, camera: int, height: int = 90, width: int = 120) -> Image:
    """Return the colours alone that a camera sees."""
    rgb = np.zeros((height, width, 3), np.uint8)
    renderer.update(data)
    renderer.render(camera, rgb)
    return rgb


@pytest.mark.gl
@pytest.mark.parametrize("size", [(64, 64), (224, 224), (120, 160)])
@pytest.mark.parametrize("camera", ["top", "side", "sensor"])
def test_colours_look_as_opengl_draws_them(make: MakeRenderer, camera: str, size: tuple[int, int]) -> None:
    model, data = build()
    number = model.camera(camera).id
    own = colours(make(model, is_rasterised=True), data, number, *size)
    differences = np.abs(own.astype(int) - colours(make(model), data, number, *size))
    assert differences.mean() < 1.0
    assert (differences.max(axis=-1) > 32).mean() < 0.01  # edges
    assert len(np.unique(own.reshape(-1, 3), axis=0)) > 20


@pytest.mark.gl
def test_a_lens_is_looked_up_as_in_opengl(make: MakeRenderer) -> None:
    model, data = build()
    rows, columns = np.mgrid[0:40, 0:48].astype(np.float32)
    lookup = np.stack([columns + 4 + 2 * np.sin(rows / 7), rows + 3], axis=-1).astype(np.float32)
    for lens in (
        _core.Lens(scale_x=1.3, scale_y=1.1, cx=20.0, cy=23.0, width=48, height=40),
        _core.Lens(cx=30.0, cy=24.0, width=60, height=50, lookup=lookup),
    ):
        pictures: list[Image] = []
        for is_rasterised in (False, True):
            renderer, rgb = make(model, is_rasterised=is_rasterised), np.zeros((40, 48, 3), np.uint8)
            renderer.update(data)
            renderer.render(model.camera("side").id, rgb, None, None, lens)
            pictures.append(rgb)
        assert np.abs(pictures[1].astype(int) - pictures[0]).mean() < 1.0
        assert len(np.unique(pictures[0].reshape(-1, 3), axis=0)) > 20


@pytest.mark.gl
def test_the_same_poses_give_the_same_colours_whatever_was_drawn_before(make: MakeRenderer) -> None:
    model, data = build()
    renderer = make(model, is_rasterised=True)
    first = colours(renderer, data, 1)
    data.qpos[:3] = [0.1, 0, 0.3]
    mujoco.mj_forward(model, data)
    moved = colours(renderer, data, 1)
    colours(renderer, data, 0, 200, 300)
    draw(renderer, data, 1)  # with depth, which is drawn by OpenGL
    np.testing.assert_array_equal(colours(renderer, data, 1), moved)
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(colours(renderer, data, 1), first)
    assert not np.array_equal(first, moved)


@pytest.mark.gl
def test_a_pool_draws_the_colours_of_a_single_renderer_for_copies_that_differ(make: MakeRenderer) -> None:
    model, data = build()
    world = World(model, copies=4, threads=2)
    green, side = model.geom("green").id, model.camera("side").id
    world.vary("geom_rgba")[1, green] = [0, 0, 1, 1]
    world.vary("light_diffuse")[2] = 0.0
    world.vary("cam_fovy")[3, side] = 30.0
    world.vary("geom_size")[3, green] *= 1.5
    pool = _core.RenderPool(model, 3, is_rasterised=True)
    rgb = [np.zeros((4, 64, 64, 3), np.uint8)]
    for _ in range(2):  # what stands still is kept from the first time
        pool.render_states(world.core.states, [side], rgb, None, world.core)
        for copy in range(4):
            single = mujoco.MjModel.from_xml_string(SCENE)
            for field in ("geom_rgba", "light_diffuse", "cam_fovy", "geom_size"):
                getattr(single, field)[:] = world.field(field)[copy]
            np.testing.assert_array_equal(colours(make(single, is_rasterised=True), data, side, 64, 64), rgb[0][copy])
    pool.close()


@pytest.mark.gl
@pytest.mark.parametrize("quality", ["fast", "full"])
def test_what_the_rasteriser_cannot_draw_is_drawn_by_opengl(make: MakeRenderer, quality: str) -> None:
    texture = '<texture name="checks" type="2d" builtin="checker" width="8" height="8"/>'
    assets = f'<asset>{texture}<material name="checked" texture="checks"/></asset><worldbody>'
    model, data = build(SCENE.replace("<worldbody>", assets) if quality == "fast" else SCENE)
    pictures = [colours(make(model, is_rasterised=own, quality=quality), data, 1) for own in (False, True)]
    np.testing.assert_array_equal(pictures[0], pictures[1])
