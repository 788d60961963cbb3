"""Pictures that are drawn without OpenGL look as OpenGL draws them, for every shape, light and lens."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from rcs import _core
from rcs.sim import World
from tests.core.drawn_scene import Image, MakeRenderer, build, draw

SHAPES = """
<mujoco>
  <statistic extent="1"/>
  <visual><headlight active="1" ambient=".3 .3 .3" diffuse=".2 .2 .2" specular="0 0 0"/></visual>
  <asset>
    <mesh name="wedge" vertex="-1 -1 0  1 -1 0  1 1 0  -1 1 0  0 -1 1  0 1 1" scale=".1 .1 .1"/>
    <material name="shiny" rgba=".8 .6 .2 1" specular=".8" shininess=".6"/>
    <material name="glowing" rgba=".2 .6 .8 1" emission=".5" specular="0"/>
  </asset>
  <worldbody>
    LIGHT
    <geom type="plane" size="2 2 .1" rgba=".5 .5 .5 1" material="shiny"/>
    <geom type="sphere" size=".1" pos="-.4 .3 .1" material="shiny"/>
    <geom type="capsule" size=".06 .1" pos="0 .3 .1" euler="60 20 0" rgba="0 1 0 1"/>
    <geom type="cylinder" size=".1 .08" pos=".4 .3 .1" euler="20 0 0" material="glowing"/>
    <geom type="ellipsoid" size=".12 .06 .09" pos="-.4 -.2 .1" euler="0 0 30" material="shiny"/>
    <geom type="box" size=".1 .07 .05" pos="0 -.2 .1" euler="0 30 30" rgba="1 0 0 1"/>
    <geom type="mesh" mesh="wedge" pos=".4 -.2 .1" rgba="0 0 1 1"/>
    <geom type="box" size=".15 .15 .01" pos=".1 .1 .35" rgba="1 1 1 .4"/>
    <camera name="top" pos="0 0 1.5" fovy="50"/>
    <camera name="side" pos="1.1 -.4 .8" xyaxes=".37 .93 0 -.5 .2 .84" fovy="50"/>
    <camera name="close" pos="0 -.45 .15" xyaxes="1 0 0 0 0 1" fovy="90"/>
  </worldbody>
</mujoco>
"""
LIGHTS = {
    "directional": '<light pos="1 1 3" dir="-.3 -.3 -1" type="directional" diffuse=".5 .5 .5" specular=".5 .5 .5"/>',
    "point": '<light pos=".5 .5 1" type="point" diffuse=".6 .6 .6" attenuation="1 .2 .1"/>',
    "spot": '<light pos=".2 .2 2" dir="0 0 -1" diffuse=".7 .7 .7" cutoff="25" exponent="5"/>',
    "none": "",
}
SIZE = 64


def pixels_of(model: mujoco.MjModel, camera: str, **options: Any) -> Image:
    """Return what a camera sees, (3, height, width)."""
    options = {"width": SIZE, "height": SIZE, **options}
    options = {"max_width": options["width"], "max_height": options["height"], **options}
    cameras = _core.PixelCameras(model, 1, 1, [model.camera(camera).id], **options)
    channels = 1 if options.get("is_grayscale") else 3
    frames = np.zeros((1, channels, options["height"], options["width"]), np.uint8)
    cameras.turn([frames])
    cameras.show(World(model).core, np.array([cameras.START], np.uint8))
    assert not cameras.why_opengl
    return frames[0]


@pytest.mark.gl
@pytest.mark.parametrize("camera", ["top", "side", "close"])
@pytest.mark.parametrize("light", LIGHTS)
def test_every_shape_looks_as_opengl_draws_it(make: MakeRenderer, light: str, camera: str) -> None:
    model, data = build(SHAPES.replace("LIGHT", LIGHTS[light]))
    expected = draw(make(model), data, model.camera(camera).id, SIZE, SIZE)[0]
    differences = np.abs(np.moveaxis(pixels_of(model, camera), 0, -1).astype(int) - expected)
    assert differences.mean() < 2.0
    assert (differences.max(axis=-1) > 32).mean() < 0.01  # edges
    assert len(np.unique(expected.reshape(-1, 3), axis=0)) > 50


FLOODED = '<light pos="0 0 3" dir="0 0 -1" type="directional" diffuse=".05 .05 .05" specular="0 0 0"/>'


@pytest.mark.gl
@pytest.mark.parametrize(
    ("light", "before", "after"),
    [
        (12 * FLOODED, "", ""),
        ("", 'active="1"', 'active="0"'),
        (LIGHTS["directional"], 'active="1"', 'active="0"'),
        (LIGHTS["directional"], '<headlight', '<map zfar="1.25"/><headlight'),
    ],
    ids=["more lights than OpenGL has", "no light", "no headlight", "a near far plane"],
)  # fmt: skip
def test_lights_and_the_far_plane_end_where_opengl_ends_them(
    make: MakeRenderer, light: str, before: str, after: str
) -> None:
    model, data = build(SHAPES.replace("LIGHT", light).replace(before, after, 1))
    expected = draw(make(model), data, model.camera("side").id, SIZE, SIZE)[0]
    differences = np.abs(np.moveaxis(pixels_of(model, "side"), 0, -1).astype(int) - expected)
    assert differences.mean() < 2.0
    assert (differences.max(axis=-1) > 32).mean() < 0.01
    assert len(np.unique(expected.reshape(-1, 3), axis=0)) > 5


@pytest.mark.gl
def test_a_lens_is_that_of_pictures(make: MakeRenderer) -> None:
    model, data = build(SHAPES.replace("LIGHT", LIGHTS["directional"]))
    renderer = make(model)
    rows, columns = np.mgrid[0:40, 0:48].astype(np.float32)
    lookup = np.stack([columns + 4 + 2 * np.sin(rows / 7), rows + 3], axis=-1).astype(np.float32)
    lenses = [
        _core.Lens(scale_x=1.3, scale_y=1.1, cx=20.0, cy=23.0, width=48, height=40),
        _core.Lens(cx=30.0, cy=24.0, width=60, height=50, lookup=lookup),
    ]
    for lens in lenses:
        expected = np.zeros((40, 48, 3), np.uint8)
        renderer.update(data)
        renderer.render(model.camera("side").id, expected, None, None, lens)
        seen = pixels_of(model, "side", width=48, height=40, lenses=[lens], max_width=60, max_height=50)
        differences = np.abs(np.moveaxis(seen, 0, -1).astype(int) - expected)
        assert differences.mean() < 2.0
        assert (differences.max(axis=-1) > 32).mean() < 0.01


def test_the_backdrop_changes_with_what_is_in_it() -> None:
    model, _ = build(SHAPES.replace("LIGHT", LIGHTS["directional"]))
    cameras = _core.PixelCameras(
        model, 3, 1, [model.camera("side").id], width=SIZE, height=SIZE, max_width=SIZE, max_height=SIZE
    )
    world = World(model, copies=3, threads=1)
    world.vary("geom_rgba")[1, 0] = [1, 0, 0, 1]
    world.vary("light_diffuse")[2] = 0.1
    frames = np.zeros((3, 3, SIZE, SIZE), np.uint8)
    cameras.turn([frames])
    cameras.show(world.core, np.full(3, cameras.START, np.uint8))
    again = np.zeros_like(frames)
    cameras.turn([again])
    for copy in (2, 0, 1):
        uses = np.full(3, cameras.LEAVE, np.uint8)
        uses[copy] = cameras.START
        cameras.show(world.core, uses)
    np.testing.assert_array_equal(again, frames)
    assert len({frame.tobytes() for frame in frames}) == 3


@pytest.mark.parametrize(
    ("part", "why"),
    [
        ('<asset><texture name="t" type="2d" builtin="checker" width="8" height="8"/>'
         '<material name="m" texture="t"/></asset>', "textures"),
        ('<asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1"/></asset><worldbody>'
         '<geom type="hfield" hfield="h"/></worldbody>', "height field"),
    ],
)  # fmt: skip
@pytest.mark.gl
def test_what_only_opengl_can_draw_is_drawn_by_it(make: MakeRenderer, part: str, why: str) -> None:
    model, data = build(SHAPES.replace("LIGHT", "").replace("<worldbody>", part + "<worldbody>", 1))
    camera = model.camera("side").id
    cameras = _core.PixelCameras(model, 1, 1, [camera], width=SIZE, height=SIZE, max_width=SIZE, max_height=SIZE)
    assert why in cameras.why_opengl
    frames = np.zeros((1, 3, SIZE, SIZE), np.uint8)
    cameras.turn([frames])
    cameras.show(World(model).core, np.array([cameras.START], np.uint8))
    np.testing.assert_array_equal(np.moveaxis(frames[0], 0, -1), draw(make(model), data, camera, SIZE, SIZE)[0])


def test_arrays_that_do_not_fit_are_refused() -> None:
    model, _ = build(SHAPES.replace("LIGHT", ""))
    world = World(model).core
    cameras = _core.PixelCameras(model, 1, 1, [0], width=8, height=6, max_width=8, max_height=6)
    frames = np.zeros((1, 3, 6, 8), np.uint8)
    with pytest.raises(ValueError, match=r"\(1, 3, 6, 8\)"):
        cameras.turn([frames[:, :1].copy()])
    with pytest.raises(ValueError, match="one array for each camera"):
        cameras.turn([frames, frames])
    with pytest.raises(TypeError):
        cameras.turn([frames.astype(np.float32)])
    cameras.turn([frames])
    with pytest.raises(ValueError, match="one entry for each copy"):
        cameras.show(world, np.zeros(2, np.uint8))
    with pytest.raises(ValueError, match="0 to 4"):
        cameras.show(world, np.full(1, 9, np.uint8))
    with pytest.raises(ValueError, match="no camera 9"):
        _core.PixelCameras(model, 1, 1, [9], width=8, height=6, max_width=8, max_height=6)
