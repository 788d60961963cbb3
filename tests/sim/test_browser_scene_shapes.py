"""The look of a model for other viewers: what MuJoCo shows, each once, where the state has it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import rcs
from rcs.sim.browser_scene import colour_of, shapes_of, soft_vertices
from rcs.spatial import compose, tquat_to_matrix, wxyz_to_xyzw

PRIMITIVES = """
<mujoco>
  <asset>
    <mesh name="wedge" vertex="0 0 0 .2 0 0 0 .1 0 0 0 .3"/>
    <texture name="half" type="2d" builtin="checker" rgb1="1 0 0" rgb2="0 0 1" width="8" height="8"/>
    <material name="painted" rgba=".2 .4 .6 1"/>
    <material name="woven" texture="half"/>
  </asset>
  <worldbody>
    <geom name="ground" type="plane" size="1 2 .1"/>
    <body pos=".1 .2 .3" euler="10 20 30">
      <freejoint/>
      <geom name="ball" type="sphere" size=".1" rgba="1 0 0 .5"/>
      <geom name="egg" type="ellipsoid" size=".1 .2 .3" pos="1 0 0" material="painted"/>
      <geom name="pill" type="capsule" size=".1 .2" pos="2 0 0" rgba="0 1 0 1" material="painted"/>
      <geom name="can" type="cylinder" size=".1 .2" euler="0 90 0"/>
      <geom name="crate" type="box" size=".1 .2 .3" material="woven"/>
      <geom name="wedge" type="mesh" mesh="wedge" pos="0 1 0"/>
      <geom name="unseen" type="sphere" size=".1" group="3"/>
      <geom name="clear" type="sphere" size=".1" rgba="1 0 0 0"/>
    </body>
  </worldbody>
</mujoco>
"""


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the volume that triangles enclose, if their normals point out of it."""
    a, b, c = (vertices[faces[:, i]].astype(float) for i in range(3))
    return float((np.cross(a, b) * c).sum() / 6)


def shown_by_mujoco(model: mujoco.MjModel, data: mujoco.MjData) -> dict[int, mujoco.MjvGeom]:
    """Return by its id every geom that MuJoCo's own viewer would draw."""
    scene = mujoco.MjvScene(model, 2000)
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene)
    geoms = (scene.geoms[i] for i in range(scene.ngeom))
    return {geom.objid: geom for geom in geoms if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM}


@pytest.mark.parametrize(
    ("task", "robot"),
    [("PickCuboid", "fr3"), ("LiftBar", "dual_fr3"), ("PickCuboid", "so101"), ("PickToy", "xarm7")],
)
def test_what_mujoco_shows_is_there_once_in_the_same_place_and_colour(task: str, robot: str) -> None:
    env = rcs.make(task, robot=robot)
    env.reset(seed=3)
    env.step(env.action_space.sample())
    model, data = env.simulation.world.model, env.simulation.world.data
    assert data is not None
    mujoco.mj_kinematics(model, data)
    shapes = shapes_of(model, data)
    names = [shape.name for shape in shapes]
    assert len(set(names)) == len(names)
    shown = {model.geom(i).name or f"geom {i}": geom for i, geom in shown_by_mujoco(model, data).items()}
    assert {shape.name for shape in shapes if shape.flex is None} == set(shown)
    for shape in shapes:
        if shape.flex is None:
            body = np.concatenate([data.xpos[shape.body], wxyz_to_xyzw(data.xquat[shape.body])])
            place = tquat_to_matrix(compose(body, shape.in_body))
            np.testing.assert_allclose(place[:3, 3], shown[shape.name].pos, atol=1e-6)
            np.testing.assert_allclose(place[:3, :3], shown[shape.name].mat, atol=1e-6)
            np.testing.assert_allclose(shape.rgba, shown[shape.name].rgba, atol=1e-6)
    assert len([shape for shape in shapes if shape.flex is not None]) == model.nflex
    env.close()


def test_every_kind_of_geom_has_its_size_and_its_surface_looks_outwards() -> None:
    model = mujoco.MjModel.from_xml_string(PRIMITIVES)
    shapes = {shape.name: shape for shape in shapes_of(model, mujoco.MjData(model))}
    assert set(shapes) == {"ground", "ball", "egg", "pill", "can", "crate", "wedge"}
    # A polygon with 32 corners has 0.994 of its circle's area.
    for name, whole, accuracy in (
        ("ball", 4 / 3 * np.pi * 0.1**3, 0.02),
        ("egg", 4 / 3 * np.pi * 0.006, 0.02),
        ("pill", np.pi * 0.01 * 0.4 + 4 / 3 * np.pi * 0.1**3, 0.02),
        ("can", np.pi * 0.01 * 0.4, 0.01),
        ("crate", 8 * 0.006, 1e-6),
        ("wedge", 0.2 * 0.1 * 0.3 / 6, 1e-6),
    ):
        assert volume(*shapes[name].mesh) == pytest.approx(whole, rel=accuracy), name
    for name, half in {
        "ball": (0.1, 0.1, 0.1),
        "egg": (0.1, 0.2, 0.3),
        "pill": (0.1, 0.1, 0.3),
        "can": (0.1, 0.1, 0.2),
        "crate": (0.1, 0.2, 0.3),
        "ground": (1.0, 2.0, 0.0),
    }.items():
        np.testing.assert_allclose(shapes[name].mesh[0].max(axis=0), half, atol=1e-6, err_msg=name)
        np.testing.assert_allclose(shapes[name].mesh[0].min(axis=0), np.negative(half), atol=1e-6, err_msg=name)


def test_the_ground_looks_up() -> None:
    model = mujoco.MjModel.from_xml_string(PRIMITIVES)
    vertices, faces = shapes_of(model, mujoco.MjData(model))[0].mesh
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_a_colour_of_its_own_goes_before_that_of_the_material_and_a_texture_has_its_mean() -> None:
    model = mujoco.MjModel.from_xml_string(PRIMITIVES)
    shapes = {shape.name: shape.rgba for shape in shapes_of(model, mujoco.MjData(model))}
    assert shapes["egg"] == (0.2, 0.4, 0.6, 1.0)
    assert shapes["pill"] == (0.0, 1.0, 0.0, 1.0)
    assert shapes["ball"] == (1.0, 0.0, 0.0, 0.5)
    assert shapes["crate"] == pytest.approx((0.5, 0.0, 0.5, 1.0), abs=0.01)
    assert colour_of(model, np.array([0.1, 0.2, 0.3, 1.0], np.float32), -1) == pytest.approx((0.1, 0.2, 0.3, 1.0))


def test_a_new_colour_is_a_new_look_and_nothing_else_is() -> None:
    model = mujoco.MjModel.from_xml_string(PRIMITIVES)
    data = mujoco.MjData(model)
    before = {shape.name: shape.look for shape in shapes_of(model, data)}
    model.geom("can").rgba = [0.0, 0.0, 1.0, 1.0]
    after = {shape.name: shape.look for shape in shapes_of(model, data)}
    assert [name for name in before if before[name] != after[name]] == ["can"]


def test_a_soft_body_is_its_outer_surface_where_its_vertices_are() -> None:
    env = rcs.make("PickToy", robot="xarm7")
    env.reset(seed=0)
    model, data = env.simulation.world.model, env.simulation.world.data
    assert data is not None
    mujoco.mj_flex(model, data)
    (toy,) = (shape for shape in shapes_of(model, data) if shape.flex is not None)
    vertices, faces = toy.mesh
    np.testing.assert_array_equal(vertices, soft_vertices(model, data, 0))
    # Every edge of a closed surface belongs to two triangles.
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    assert abs(volume(vertices, faces)) > 1e-5
    env.close()
