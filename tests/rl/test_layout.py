from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import rcs
from rcs.envs import spaces as keys
from rcs.errors import InvalidSetup
from rcs.rl import Flat, FlatLayout
from rcs.rl.layout import Scales, bounds_of, layout_of_spaces

BOX = spaces.Box(0, 1, (1,), np.float32)


def flat_of(action: spaces.Space[Any], observation: spaces.Space[Any]) -> Flat:
    """Return the maps of an FR3 with other spaces."""
    return Flat(layout_of_spaces(action, observation, Scales(rcs.make().robots, None)))


def test_a_layout_prints_every_number_with_its_unit() -> None:
    flat = Flat(rcs.make(observe=("privileged",)))
    text = str(flat.layout)
    assert "(value - [0 … 0.5]) / 0.25 m" in text
    assert "privileged/cuboid/tquat (relative turn)" in text
    assert repr(flat) == f"Flat({flat.layout.state_size} numbers -> 8 numbers)"


def test_features_of_poses_are_differences_without_an_offset() -> None:
    layout = Flat(rcs.make(observe=("privileged",))).layout
    features = [entry for entry in layout.state if entry.kind != "value"]
    assert {entry.kind for entry in features} >= {"turn", "relative_turn", "near"}
    for entry in features:
        assert set(entry.offset) == {0.0}
        assert set(entry.scale) == ({1.0} if entry.unit == "" else set(entry.scale[:1]))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda values: values["state"][1].update(colour="red"), "no option of Entry named 'colour'"),
        (lambda values: values["state"][1]["scale"].append(1.0), "'gripper' has 1 offsets and 2 scales"),
        (lambda values: values["state"][1].update(kind="guess"), "kind is 'guess'; valid: 'value', 'turn'"),
        (lambda values: values["state"][1].update(scale=[0.0]), "scale is .*; valid: a sequence.* above 0"),
        (lambda values: values.update(images=[{"key": "a", "name": "a", "shape": [3, 4]}]), "shape is"),
    ],
)
def test_a_damaged_layout_is_refused(damage: Any, message: str) -> None:
    flat = flat_of(spaces.Dict(a=BOX), spaces.Dict(joints=BOX, gripper=BOX))
    values = flat.layout.to_json()
    FlatLayout.from_json(values)
    damage(values)
    with pytest.raises(InvalidSetup, match=message):
        FlatLayout.from_json(values)


def test_keys_choose_what_is_observed() -> None:
    env = rcs.make(observe=("privileged", "contacts"))
    whole = Flat(env)
    flat = Flat(env, keys=("joints", "privileged"))
    assert [one.key for one in flat.layout.state if one.kind == "value"] == [
        "joints", "privileged/cuboid/tquat", "privileged/cuboid/velocity",
    ]  # fmt: skip
    observation, _ = env.reset(seed=0)
    redundant = Flat(env, keys=("xyzrpy",))
    (entry,) = redundant.layout.state
    vector = redundant.observation(observation) * np.array(entry.scale) + entry.offset
    np.testing.assert_allclose(vector, observation["xyzrpy"], atol=1e-6)
    with pytest.raises(InvalidSetup, match="no key 'joint' of numbers in the observation; valid: finger_contacts"):
        Flat(env, keys=("joint",))
    with pytest.raises(InvalidSetup, match="A layout was given and also keys"):
        Flat(whole.layout, keys=())


def test_spaces_without_numbers_or_bounds_are_refused() -> None:
    box = spaces.Box(-1, 1, (2,))
    with pytest.raises(InvalidSetup, match="'mode' has the space Discrete"):
        flat_of(spaces.Dict(mode=spaces.Discrete(3)), spaces.Dict(a=box))
    with pytest.raises(InvalidSetup, match="'force' has no finite bounds"):
        flat_of(spaces.Dict(force=spaces.Box(-np.inf, np.inf, (1,))), spaces.Dict(a=box))
    with pytest.raises(InvalidSetup, match="Nothing is left to observe"):
        flat_of(spaces.Dict(a=box), spaces.Dict())
    unbounded = spaces.Dict(a=spaces.Box(np.array([-np.inf, 0]), np.array([np.inf, 4]), dtype=np.float64), b=box)
    flat = flat_of(spaces.Dict(a=box), unbounded)
    np.testing.assert_array_equal(flat.observation({"a": np.array([30.0, 4.0]), "b": np.zeros(2)}), [30, 1, 0, 0])
    with pytest.raises(InvalidSetup, match=r"make it with rcs\.make"):
        Flat(gymnasium.make("CartPole-v1"))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("robot", ["fr3", "ur5e", "so101", "xarm7"])
def test_positions_are_measured_from_the_middle_of_the_task_s_area(robot: str) -> None:
    env = rcs.make("Free" if robot == "xarm7" else "PickCuboid", robot=robot)
    area, placement = env.simulation.task.area, env.robots[robot]
    scales = Scales(env.robots, area)
    offset, scale = (numbers[:3] for numbers in scales.of(keys.TQUAT, keys.tquat_space()))
    mount = placement.base_in_scene
    in_scene = rcs.Pose(mount.translation, mount.quaternion) * rcs.Pose(offset, (0, 0, 0, 1))
    np.testing.assert_allclose(in_scene.translation, [*area.center, 0.0], atol=1e-9)
    corner = 0.5 * np.array(area.size)
    assert np.linalg.norm(corner) <= scale[0] + 1e-12  # all of the area is within 1
    assert scale[0] >= 0.25 * placement.arm.workspace_reach
    speeds = scales.of(keys.JOINT_VELOCITIES, keys.velocities_space(placement.arm.dof))
    np.testing.assert_array_equal(speeds[1], placement.arm.velocity_limit)


def test_what_occurs_is_far_smaller_than_the_bounds_of_velocities_and_forces() -> None:
    scales = Scales(rcs.make().robots, None)
    for key, box in (
        (keys.JOINT_VELOCITIES, keys.velocities_space(7)),
        (f"privileged/cup/{keys.VELOCITY}", keys.object_space()[keys.VELOCITY]),
        (keys.TQUAT, keys.tquat_space()),
        (keys.XYZRPY, keys.xyzrpy_space()),
        (keys.TCP_WRENCH, keys.load_spaces([1.0])[keys.TCP_WRENCH]),
    ):
        offset, scale = scales.of(key, box)
        assert offset.shape == scale.shape == box.shape
        assert (scale > 0).all()
        assert (scale < 0.1 * box.high).all() or key in (keys.TQUAT, keys.XYZRPY)


@pytest.mark.parametrize(
    ("low", "high", "offset", "scale"),
    [
        ([-1, 0], [3, 1], [1, 0.5], [2, 0.5]),
        ([2, -np.inf], [2, 5], [2, 0], [1, 1]),
        ([0, 0], [np.inf, 2], [0, 1], [1, 1]),
    ],
)
def test_bounds_become_minus_one_and_one_where_there_are_any(low: Any, high: Any, offset: Any, scale: Any) -> None:
    found = bounds_of(spaces.Box(np.array(low, np.float64), np.array(high, np.float64), dtype=np.float64))
    np.testing.assert_array_equal(found[0], offset)
    np.testing.assert_array_equal(found[1], scale)


@pytest.mark.parametrize("robot", ["fr3", "so101"])
def test_positions_are_0_in_the_middle_of_the_tasks_area_on_the_ground(robot: str) -> None:
    with rcs.make("PickCuboid", robot=robot, observe=("privileged",)) as env:
        area, (placed,) = env.simulation.task.area, env.robots.values()
        middle = placed.base_in_scene.pose.inverse().apply([*area.center, 0.0])
        entries = [entry for entry in Flat(env).layout.state if entry.unit == "m" and entry.kind == "value"]
    assert {entry.key for entry in entries} == {"tquat", "privileged/cuboid/tquat"}
    for entry in entries:
        assert entry.offset == pytest.approx(tuple(middle), abs=1e-9)
