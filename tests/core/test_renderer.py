"""Pictures show what the geometry of the scene says they must."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mujoco
import numpy as np
import pytest

from rcs import _core
from rcs.errors import WrongOrder
from tests.core.drawn_scene import SCENE, MakeRenderer, build, draw, state_of

# Shapes one at a time, on an axis that no camera below looks along.
SHAPES = {
    "sphere": 'type="sphere" size=".2"',
    "ellipsoid": 'type="ellipsoid" size=".1 .2 .25"',
    "capsule": 'type="capsule" size=".1 .15"',
    "cylinder": 'type="cylinder" size=".12 .2"',
}


def in_camera(data: mujoco.MjData, camera: int, point: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return a point of the world in a camera's OpenCV axes: x right, y down, z forward."""
    rotation = data.cam_xmat[camera].reshape(3, 3) * [1, -1, -1]
    return rotation.T @ (point - data.cam_xpos[camera])


@pytest.mark.gl
@pytest.mark.parametrize("quality", ["fast", "full"])
@pytest.mark.parametrize("camera", ["top", "side"])
def test_geoms_appear_where_a_pinhole_camera_projects_them(make: MakeRenderer, quality: str, camera: str) -> None:
    model, data = build()
    camera_id = model.camera(camera).id
    rgb, _ = draw(make(model, quality=quality), data, camera_id)
    focal = 45 / np.tan(np.radians(model.cam_fovy[camera_id]) / 2)
    for channel, name in enumerate(("red", "green", "blue")):
        x, y, z = in_camera(data, camera_id, data.geom(name).xpos)
        pixel = rgb[int(45 + focal * y / z), int(60 + focal * x / z)].astype(int)
        assert pixel[channel] > 100
        assert np.delete(pixel, channel).max() < 30


@pytest.mark.gl
def test_a_camera_with_a_sensor_has_its_focal_length_and_principal_point(make: MakeRenderer) -> None:
    model, data = build()
    camera = model.camera("sensor").id
    rgb, _ = draw(make(model), data, camera, 60, 80)
    x, y, z = in_camera(data, camera, data.geom("red").xpos)
    rows, columns = np.nonzero(rgb[:, :, 0].astype(int) - rgb[:, :, 1] > 60)
    shift = np.array([columns.mean() + 0.5 - 40, rows.mean() + 0.5 - 30]) - 70 * np.array([x, y]) / z
    # MuJoCo moves the picture, not the axis: to the left for a positive first number, down for a negative second one.
    np.testing.assert_allclose(shift, [-6, 4], atol=0.5)


@pytest.mark.gl
@pytest.mark.parametrize("quality", ["fast", "full"])
def test_depth_is_the_distance_of_the_plane_along_the_optical_axis(make: MakeRenderer, quality: str) -> None:
    model, data = build()
    rgb, depth = draw(make(model, quality=quality), data, model.camera("top").id, 240, 320)
    floor = (np.ptp(rgb.astype(int), axis=2) < 10) & (depth > 1499)
    assert floor.mean() > 0.8
    np.testing.assert_allclose(depth[floor], 1500, atol=1)


@pytest.mark.gl
def test_depth_of_a_tilted_view_puts_every_floor_pixel_on_the_floor(make: MakeRenderer) -> None:
    model, data = build()
    camera = model.camera("side").id
    rgb, depth = draw(make(model), data, camera, 90, 120)
    focal = 45 / np.tan(np.radians(60) / 2)
    rows, columns = np.nonzero((np.ptp(rgb.astype(int), axis=2) < 3) & (depth > 0))
    rays = np.stack([(columns + 0.5 - 60) / focal, (rows + 0.5 - 45) / focal, np.ones(len(rows))])
    rotation = data.cam_xmat[camera].reshape(3, 3) * [1, -1, -1]
    height = data.cam_xpos[camera, 2] + (rotation @ rays)[2] * depth[rows, columns] / 1000
    assert len(rows) > 4000
    assert np.abs(height).max() < 0.0015


@pytest.mark.gl
def test_depth_is_zero_where_nothing_is_and_beyond_what_sixteen_bits_hold(make: MakeRenderer) -> None:
    model, data = build(
        """<mujoco><statistic extent="5"/><worldbody>
        <geom type="box" size="9 9 1" pos="-9 0 -66"/><geom type="box" size="9 9 1" pos="9 0 -68"/>
        <camera pos="0 0 0" fovy="10"/></worldbody></mujoco>"""
    )
    _, depth = draw(make(model), data, height=64, width=64)
    assert depth[32, 10] == pytest.approx(65000, abs=5)
    assert depth[32, 50] == 0
    model, data = build("<mujoco><worldbody><camera/></worldbody></mujoco>")
    rgb, depth = draw(make(model), data)
    assert not rgb.any()
    assert not depth.any()


@pytest.mark.gl
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("height", [96, 240])
def test_coarse_round_shapes_fill_the_outline_of_fine_ones(make: MakeRenderer, shape: str, height: int) -> None:
    axes = ("0 1 0 0 0 1", "0 1 0 1 0 1", "1 0 0 0 1 0", "1 0 0 0 -1 0")
    points = ("1 0 0", "1 0 -1", "0 0 1", "0 0 -1")
    cameras = "".join(f'<camera pos="{p}" xyaxes="{a}"/>' for p, a in zip(points, axes, strict=True))
    model, data = build(f"<mujoco><worldbody><geom {SHAPES[shape]}/>{cameras}</worldbody></mujoco>")
    fast, full = make(model), make(model, quality="full")
    for camera in range(model.ncam):
        (_, coarse), (_, fine) = (draw(r, data, camera, height, height) for r in (fast, full))
        assert ((coarse > 0) & (fine > 0)).sum() > 0.9 * ((coarse > 0) | (fine > 0)).sum()
        both = (coarse > 0) & (fine > 0)
        # A corner every 30 degrees keeps a surface within 1.7 % of its radius both ways, and both curvatures add up.
        # Depths are whole millimetres.
        assert np.median(np.abs(coarse[both].astype(int) - fine[both])) <= 0.034 * 200 + 0.5


@pytest.mark.gl
@pytest.mark.parametrize("offset", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_a_geom_with_its_middle_outside_the_picture_is_still_seen(make: MakeRenderer, offset: tuple[int, int]) -> None:
    half = np.tan(np.radians(45) / 2)
    x, y = np.array(offset) * (half + 0.03)
    model, data = build(
        f"""<mujoco><worldbody><geom type="sphere" size=".06" pos="{x} {y} 0"/><camera pos="0 0 1" fovy="45"/>
        </worldbody></mujoco>"""
    )
    _, depth = draw(make(model), data, height=96, width=96)
    rows, columns = np.nonzero(depth)
    assert len(rows) > 10
    assert np.sign(np.round([columns.mean() - 47.5, 47.5 - rows.mean()], -1)).astype(int).tolist() == list(offset)


@pytest.mark.gl
def test_the_same_poses_give_the_same_picture_whatever_was_drawn_before(make: MakeRenderer) -> None:
    model, data = build()
    renderer = make(model)
    first = draw(renderer, data, 1)
    draw(renderer, data, 0, 200, 300)
    again = draw(renderer, data, 1)
    fresh = draw(make(model), data, 1)
    for rgb, depth in (again, fresh):
        np.testing.assert_array_equal(rgb, first[0])
        np.testing.assert_array_equal(depth, first[1])


@pytest.mark.gl
def test_a_state_gives_the_picture_of_the_data_it_was_taken_from(make: MakeRenderer) -> None:
    model, data = build()
    data.qpos[:3] = [0.1, 0, 0.3]
    mujoco.mj_forward(model, data)
    renderer = make(model)
    wanted, _ = draw(renderer, data)
    rgb = np.zeros_like(wanted)
    renderer.update_from_state(state_of(model, data))
    renderer.render(0, rgb)
    np.testing.assert_array_equal(rgb, wanted)


@pytest.mark.gl
def test_threads_may_share_a_renderer_or_have_their_own(make: MakeRenderer) -> None:
    model, data = build()
    shared = make(model)
    wanted, _ = draw(shared, data)

    def draw_often(renderer: _core.Renderer) -> bool:
        rgb = np.zeros_like(wanted)
        equal = True
        for _ in range(20):
            renderer.render(0, rgb)
            equal &= np.array_equal(rgb, wanted)
        return equal

    own = [make(model), make(model)]
    for renderer in own:
        renderer.update(data)
    with ThreadPoolExecutor(4) as threads:
        assert all(threads.map(draw_often, [shared, shared, *own]))


@pytest.mark.gl
def test_collision_geoms_are_drawn_only_when_asked_for(make: MakeRenderer) -> None:
    model, data = build()
    x, y, z = in_camera(data, 0, data.geom("collision").xpos)
    focal = 45 / np.tan(np.radians(45) / 2)
    row, column = int(45 + focal * y / z), int(60 + focal * x / z)
    hidden, _ = draw(make(model), data)
    shown, _ = draw(make(model, geom_groups=[True, False, False, True, False, False]), data)
    assert np.ptp(hidden[row, column].astype(int)) < 5
    assert shown[row, column, 0] > 100 > 30 > shown[row, column, 2]


@pytest.mark.gl
@pytest.mark.parametrize("quality", ["fast", "full"])
def test_drawing_does_not_change_the_model(make: MakeRenderer, quality: str) -> None:
    model, data = build()

    def content() -> bytes:
        buffer = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, buffer)
        return buffer.tobytes()

    before = content()
    draw(make(model, quality=quality), data)
    assert content() == before


@pytest.mark.gl
def test_a_closed_renderer_refuses_to_draw_and_closes_twice(make: MakeRenderer) -> None:
    model, data = build()
    renderer = make(model)
    draw(renderer, data)
    renderer.close()
    renderer.close()
    assert not renderer.is_open
    with pytest.raises(WrongOrder, match="after close"):
        draw(renderer, data)
    pool = _core.RenderPool(model, 2)
    pool.close()
    pool.close()
    assert not pool.is_open
    with pytest.raises(WrongOrder, match="after close"):
        pool.render_states(np.zeros((1, pool.state_size)), [0], [np.zeros((1, 8, 8, 3), np.uint8)])


@pytest.mark.gl
def test_drawing_before_there_are_poses_is_refused(make: MakeRenderer) -> None:
    model, _ = build()
    with pytest.raises(WrongOrder, match="before update"):
        make(model).render(0, np.zeros((8, 8, 3), np.uint8))


@pytest.mark.gl
def test_pictures_that_do_not_fit_are_refused_with_what_is_valid(make: MakeRenderer) -> None:
    model, data = build()
    renderer = make(model, max_width=64, max_height=48)
    renderer.update(data)
    good = np.zeros((48, 64, 3), np.uint8)
    with pytest.raises(ValueError, match=r"no camera 3; the model has 0 \(top\), 1 \(side\), 2 \(sensor\)"):
        renderer.render(3, good)
    with pytest.raises(ValueError, match="1 x 1 to 64 x 48"):
        renderer.render(0, np.zeros((48, 65, 3), np.uint8))
    with pytest.raises(ValueError, match="height and width of rgb"):
        renderer.render(0, good, np.zeros((48, 63), np.uint16))
    with pytest.raises(ValueError, match=f"{renderer.state_size}"):
        renderer.update_from_state(np.zeros(renderer.state_size + 1))
    # These would be filled in a copy that nobody sees.
    for wrong in (good.astype(float), good[:, ::2], np.zeros((48, 64), np.uint8)):
        with pytest.raises(TypeError):
            renderer.render(0, wrong)  # pyright: ignore[reportArgumentType]
    good.flags.writeable = False
    with pytest.raises(TypeError):
        renderer.render(0, good)


@pytest.mark.gl
def test_options_that_mean_nothing_are_refused(make: MakeRenderer) -> None:
    model, _ = build()
    with pytest.raises(ValueError, match="known: fast, full"):
        make(model, quality="best")
    with pytest.raises(ValueError, match="known: auto, egl, osmesa"):
        make(model, backend="vulkan")
    with pytest.raises(ValueError, match="at least 1 x 1"):
        make(model, max_width=0)
    with pytest.raises(ValueError, match="pixels can be drawn here"):
        make(model, max_width=10**6)
    for threads in (0, 2000):
        with pytest.raises(ValueError, match=f"{threads} threads were asked for, valid is 1 to 64"):
            _core.RenderPool(model, threads)


@pytest.mark.gl
def test_data_of_another_model_is_refused(make: MakeRenderer) -> None:
    model, _ = build()
    other = mujoco.MjModel.from_xml_string("<mujoco/>")
    with pytest.raises(ValueError, match="of another model"):
        make(model).update(mujoco.MjData(other))
    for wrong in (0, None, model):
        with pytest.raises(TypeError):
            make(model).update(wrong)  # pyright: ignore[reportArgumentType]


@pytest.mark.gl
@pytest.mark.parametrize("quality", ["fast", "full"])
@pytest.mark.parametrize("camera", ["top", "side", "sensor"])
def test_ids_are_those_of_the_geoms_that_the_colours_show(make: MakeRenderer, quality: str, camera: str) -> None:
    model, data = build()
    rgb, _ = draw(make(model, quality=quality), data, model.camera(camera).id, 180, 240)
    again, ids = np.empty_like(rgb), np.empty((180, 240), np.uint16)
    renderer = make(model, quality=quality)
    renderer.update(data)
    renderer.render(model.camera(camera).id, again, None, ids)
    np.testing.assert_array_equal(rgb, again, "colours do not change by what is drawn besides")
    assert set(np.unique(ids)) <= {0, *(model.geom(name).id + 1 for name in ("floor", "red", "green", "blue"))}
    for channel, name in enumerate(("red", "green", "blue")):
        is_coloured = rgb[..., channel].astype(int) - np.delete(rgb, channel, axis=2).max(axis=2) > 60
        is_geom = ids == model.geom(name).id + 1
        assert (is_coloured ^ is_geom).sum() <= 0.15 * is_geom.sum()  # antialiased edges
        assert is_geom.sum() > 50


@pytest.mark.gl
def test_transparent_geoms_have_ids_and_depth_of_their_own_at_any_quality(make: MakeRenderer) -> None:
    pane = '<geom name="pane" type="box" size=".3 .3 .01" pos="0 0 .6" rgba="1 1 1 .3"/><geom name="floor"'
    model, data = build(SCENE.replace('<geom name="floor"', pane))
    for quality in ("fast", "full"):
        renderer = make(model, quality=quality)
        renderer.update(data)
        rgb, depth, ids = (
            np.empty((90, 120, *rest), kind) for rest, kind in (((3,), np.uint8), ((), np.uint16), ((), np.uint16))
        )
        renderer.render(model.camera("top").id, rgb, depth, ids)
        assert ids[45, 60] == model.geom("pane").id + 1
        assert depth[45, 60] == pytest.approx(1e3 * (model.camera("top").pos[2] - 0.61), abs=2)
        alone = np.empty_like(depth)
        renderer.render(model.camera("top").id, rgb, alone)
        np.testing.assert_array_equal(alone, depth)


@pytest.mark.gl
def test_what_is_not_seen_at_all_has_neither_id_nor_depth(make: MakeRenderer) -> None:
    pane = '<geom type="box" size=".3 .3 .01" pos="{} 0 .6" rgba="1 1 1 0"/>'
    glass = '<geom type="box" size=".05 .05 .05" pos="1 1 .1" rgba="1 1 1 .5"/>'
    seen = []
    for place in (50, 0):
        model, data = build(SCENE.replace("</worldbody>", glass + pane.format(place) + "</worldbody>"))
        renderer = make(model)
        renderer.update(data)
        rgb, depth, ids = (
            np.empty((90, 120, 3), np.uint8),
            np.empty((90, 120), np.uint16),
            np.empty((90, 120), np.uint16),
        )
        renderer.render(model.camera("top").id, rgb, depth, ids)
        seen.append((rgb, depth, ids))
    for beside, before in zip(*seen, strict=True):
        np.testing.assert_array_equal(before, beside)


@pytest.mark.gl
@pytest.mark.parametrize("quality", ["fast", "full"])
def test_a_model_that_asks_for_endless_detail_is_drawn_all_the_same(make: MakeRenderer, quality: str) -> None:
    """Without a bound, 20 000 squares on each side of a plane take minutes."""
    wanted = '<mujoco><visual><quality numslices="100000" numstacks="50000" numquads="20000" shadowsize="100000"/>'
    model, data = build(SCENE.replace("<mujoco>", wanted + "</visual>", 1))
    plain, _ = build()
    camera = model.camera("top").id
    rgb, _ = draw(make(model, quality=quality), data, camera, 60, 80)
    expected, _ = draw(make(plain, quality=quality), data, camera, 60, 80)
    assert np.abs(rgb.astype(int) - expected).mean() < 2.0


@pytest.mark.gl
def test_depth_beside_an_edge_is_that_of_the_pixels_middle_at_full_quality(make: MakeRenderer) -> None:
    """With several samples a pixel, one that is not in its middle gives the depth of what is beside."""
    model, data = build()
    camera = model.camera("top").id
    depths = []
    for quality in ("fast", "full"):
        _, depth = draw(make(model, quality=quality), data, camera, 240, 320)
        depths.append(depth)
    focal = 120 / np.tan(np.radians(45) / 2)
    rows, columns = np.mgrid[:240, :320]
    x, y, z = in_camera(data, camera, data.geom("blue").xpos + [0, 0, 0.05])
    radius = np.hypot(columns - 159.5 - focal * x / z, rows - 119.5 - focal * y / z) * z / focal
    lid, floor = radius < 0.0592, (radius > 0.0608) & (radius < 0.09)
    assert (np.abs(depths[1][lid] - 1e3 * z) <= 1).mean() == 1.0
    assert (depths[1][floor] > 1400).mean() > 0.95  # the side may be seen, the lid's depth not
    assert lid.sum() > 100


@pytest.mark.gl
def test_a_lens_that_does_not_fit_is_refused(make: MakeRenderer) -> None:
    model, data = build()
    renderer = make(model)
    renderer.update(data)
    rgb = np.empty((90, 120, 3), np.uint8)
    lookup = np.zeros((80, 120, 2), np.float32)
    for lens, text in (
        (_core.Lens(cx=1, cy=1, width=100, height=90), "size of the picture"),
        (_core.Lens(cx=1, cy=1, width=5000, height=90, lookup=np.zeros((90, 120, 2), np.float32)), "1 x 1 to"),
        (_core.Lens(cx=1, cy=1, width=100, height=90, lookup=lookup), "height and width"),
        (_core.Lens(cx=np.nan, cy=1, width=120, height=90), "finite principal point"),
        (_core.Lens(cx=1, cy=1, width=120, height=90, scale_x=0.0), "positive scales"),
    ):
        with pytest.raises(ValueError, match=text):
            renderer.render(0, rgb, lens=lens)
