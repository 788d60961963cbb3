"""A field range finds its elements by name, and refuses what cannot vary, with what can."""

from __future__ import annotations

import json
from typing import Any

import mujoco
import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.sim.model_fields import KINDS, FieldRange, bounds_of, find_rows, names_of, prepare_model, variable_fields

SCENE = """
<mujoco>
  <asset><material name="red" rgba="1 0 0 1"/><mesh name="wedge" vertex="0 0 0 .2 0 0 0 .1 0 0 0 .3"/></asset>
  <worldbody>
    <light name="lamp"/>
    <geom name="ground" type="plane" size="1 1 .1"/>
    <body name="box" pos="0 0 1">
      <freejoint name="free"/>
      <geom type="box" size=".1 .2 .3" material="red"/>
      <geom name="knob" type="sphere" size=".1" pos=".4 0 0"/>
    </body>
    <body name="arm" pos="1 0 0">
      <joint name="hinge" axis="0 1 0"/>
      <geom name="rod" type="capsule" size=".05 .3"/>
      <geom name="rim" type="cylinder" size=".2 .1"/>
      <geom name="egg" type="ellipsoid" size=".1 .3 .2"/>
      <geom name="wedge" type="mesh" mesh="wedge"/>
      <site name="tip"/>
      <body name="ball"><geom name="ball" type="sphere" size=".1"/><joint name="slide" type="slide"/></body>
    </body>
    <body name="puck" pos="0 1 1"><freejoint/><geom type="sphere" size=".1"/></body>
    <body name="mark"/>
  </worldbody>
  <actuator><position name="servo" joint="hinge"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(SCENE)


@pytest.mark.parametrize(
    ("field", "names", "found"),
    [
        ("geom_friction", "*", ["ground", "box", "knob", "rod", "rim", "egg", "wedge", "ball", "puck"]),
        ("geom_friction", ("r*", "knob"), ["knob", "rod", "rim"]),
        ("geom_friction", "box", ["box"]),
        ("body_mass", "*", ["box", "arm", "ball", "puck", "mark"]),
        ("geom_size", ("knob", "r*"), ["knob", "rod", "rim"]),
        ("dof_armature", "*", ["free"] * 6 + ["hinge", "slide"] + ["puck"] * 6),
        ("jnt_range", "?*i*e", ["hinge", "slide"]),
        ("actuator_gainprm", "servo", ["servo"]),
        ("light_diffuse", "lamp", ["lamp"]),
        ("mat_rgba", "red", ["red"]),
        ("site_pos", "tip", ["tip"]),
    ],
)
def test_elements_are_found_by_their_names_or_those_of_their_bodies_and_joints(
    model: mujoco.MjModel, field: str, names: Any, found: list[str]
) -> None:
    rows, given = find_rows(model, FieldRange(field, 0.5, 2.0, names=names))
    assert given == found
    kind = field.partition("_")[0]
    assert [names_of(model, kind)[row] for row in rows] == found


def test_every_kind_of_element_has_as_many_names_as_its_fields_have_rows(model: mujoco.MjModel) -> None:
    assert {field.partition("_")[0] for field in variable_fields()} == set(KINDS)
    for field in variable_fields():
        assert len(getattr(model, field)) == len(names_of(model, field.partition("_")[0])), field


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"field": "geom_fricton"}, "Did you mean 'geom_friction'"),
        ({"field": "mass"}, "no numeric field of MjModel named 'mass'"),
        ({"field": "geom_type"}, "structure of the model"),
        ({"field": "tex_data"}, "structure of the model"),
        ({"field": "body_subtreemass"}, "MuJoCo computes it"),
        ({"field": "geom_rbound"}, "follows geom_size"),
        ({"field": "actuator_delay"}, "use action_latency"),
        ({"low": 3.0}, "the lower first"),
        ({"low": 0.0}, "factors above 0"),
        ({"low": float("nan")}, "finite number"),
        ({"operation": "multiply"}, "'scale', 'add', 'set'"),
        ({"per": "row"}, "'value', 'element', 'all'"),
        ({"axes": (-1,)}, "whole number from 0"),
    ],
)
def test_a_range_that_makes_no_sense_is_refused_when_it_is_made(values: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidSetup, match=words):
        FieldRange(**{"field": "geom_friction", "low": 0.5, "high": 2.0, **values})


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        (FieldRange("geom_friction", 0.5, 2.0, names="knbo"), "Did you mean 'knob'"),
        (FieldRange("geom_friction", 0.5, 2.0, names=("knob", "x*")), r"'x\*'"),
        (FieldRange("geom_friction", 0.5, 2.0, axes=(0, 3)), "columns from 0 to 2"),
        (FieldRange("body_mass", 0.5, 2.0, axes=(0,)), "one number"),
        (FieldRange("body_mass", 0.5, 2.0, names="world"), "'world'"),
        (FieldRange("geom_friction", -2.0, 0.0, operation="add"), "values from 0"),
        (FieldRange("body_mass", 0.0, 1.0, operation="set"), "values above 0"),
        (FieldRange("body_mass", -100.0, 0.0, operation="add"), "values above 0"),
        (FieldRange("body_mass", -1e-3, 0.0, names="mark", operation="add"), "without mass; valid: values from 0"),
        (FieldRange("geom_size", -0.2, 0.0, names="knob", operation="add"), "values above 0"),
        (FieldRange("geom_size", -0.1, 0.1, names="rod", operation="set"), "values above 0"),
        (FieldRange("geom_size", 0.5, 2.0, names="wedge"), "'wedge'.*simple shapes"),
        (FieldRange("body_ipos", -0.1, 0.1, names="puck", operation="add"), "off its origin"),
    ],
)
def test_a_range_that_does_not_fit_the_model_is_refused(model: mujoco.MjModel, wanted: FieldRange, words: str) -> None:
    with pytest.raises(InvalidSetup, match=words):
        find_rows(model, wanted)


def test_bounds_are_those_that_mujoco_compiles(model: mujoco.MjModel) -> None:
    simple = [model.geom(name).id for name in ("knob", "rod", "rim", "egg", "ball")] + [1]
    radius, box = bounds_of(model.geom_type[simple], np.stack([model.geom_size[simple]] * 2))
    np.testing.assert_allclose(radius, np.stack([model.geom_rbound[simple]] * 2), rtol=1e-12)
    np.testing.assert_allclose(box, np.stack([model.geom_aabb[simple]] * 2), atol=1e-12)


def test_a_prepared_model_moves_what_mujoco_has_compiled_as_being_in_the_origin() -> None:
    model = mujoco.MjModel.from_xml_string(SCENE)
    prepare_model(model, [FieldRange("geom_pos", 0.0, 0.1, names="box", operation="add")])
    data = mujoco.MjData(model)
    model.geom_pos[1] = [0.0, 0.0, 0.5]
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.geom_xpos[1], [0.0, 0.0, 1.5])


def test_json_gives_the_same_range_back() -> None:
    wanted = FieldRange("geom_friction", 0.5, 2.0, names=("a", "b*"), operation="set", axes=(0,), per="all")
    assert FieldRange.from_json(json.loads(json.dumps(wanted.to_json()))) == wanted
