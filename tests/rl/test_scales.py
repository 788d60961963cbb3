from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import rcs
from rcs.envs import spaces as keys
from rcs.errors import InvalidSetup
from rcs.rl.scales import Workplace, bounds_of, scale_of, workplace_of


@pytest.mark.parametrize("robot", ["fr3", "ur5e", "so101", "xarm7"])
def test_positions_are_measured_from_the_middle_of_the_task_s_area(robot: str) -> None:
    env = rcs.make("Free" if robot == "xarm7" else "PickCuboid", robot=robot)
    workplace = workplace_of(env)
    around = workplace.around((keys.TQUAT,))
    placement = env.robots[robot]
    mount = placement.base_in_scene
    area = env.scenario.task.area
    in_scene = rcs.Pose(mount.translation, mount.quaternion) * rcs.Pose(around.offset, (0, 0, 0, 1))
    np.testing.assert_allclose(in_scene.translation, [*area.center, 0.0], atol=1e-9)
    corner = 0.5 * np.array(area.size)
    assert np.linalg.norm(corner) <= around.scale[0] + 1e-12  # all of the area is within 1
    assert around.scale[0] >= 0.25 * placement.arm.workspace_reach
    speeds = scale_of((keys.JOINT_VELOCITIES,), keys.velocities_space(placement.arm.dof), workplace)
    np.testing.assert_array_equal(speeds.scale, placement.arm.velocity_limit)


def test_where_the_arm_is_not_known_scales_are_general_ones() -> None:
    nowhere = Workplace()
    for path, box in (
        ((keys.JOINT_VELOCITIES,), keys.velocities_space(3)),
        (("privileged", "cup", keys.VELOCITY), keys.twist_space()),
        ((keys.TQUAT,), keys.tquat_space()),
        ((keys.XYZRPY,), keys.xyzrpy_space()),
        ((keys.TCP_WRENCH,), keys.load_spaces([1.0])[keys.TCP_WRENCH]),
    ):
        scale = scale_of(path, box, nowhere)
        assert scale.offset.shape == scale.scale.shape == box.shape
        assert (scale.scale > 0).all()
        assert (scale.scale < box.high).all() or path[-1] in (keys.TQUAT, keys.XYZRPY)
        assert scale.source


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
    np.testing.assert_array_equal(found.offset, offset)
    np.testing.assert_array_equal(found.scale, scale)


def test_what_is_no_environment_of_ours_is_refused() -> None:
    with pytest.raises(InvalidSetup, match=r"make the maps with Flat\.from_spaces"):
        workplace_of(gymnasium.make("CartPole-v1"))
