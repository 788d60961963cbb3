"""The FR3 model against the published figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.spatial import Pose
from rcs.testing import DescriptionContract
from tests.robots.published import pose_of, read_figures

Figures = dict[str, Any]
FIGURES = read_figures("franka")


class TestTheDescription(DescriptionContract):
    """The arm with its hand."""

    arm = FR3
    gripper = FRANKA_HAND
    hold_tolerance = 1e-9

    def published_chain(self) -> tuple[str, list[Pose]]:
        """Return the vendor's joint table with the flange, the hand's mount and its TCP."""
        hand = FIGURES["franka_hand"]
        last = (
            Pose(FIGURES["fr3"]["flange_xyz"])
            * Pose.from_rpy((0.0, 0.0, 0.0), hand["mount_rpy"])
            * Pose(hand["tcp_xyz"])
        )
        return "gripper/tcp", [*map(pose_of, FIGURES["fr3"]["chain"]), last]


def set_joints(model: mujoco.MjModel, data: mujoco.MjData, q: NDArray[np.float64], prefix: str = "") -> None:
    for joint, value in zip(FR3.joints, q, strict=True):
        data.joint(prefix + joint).qpos[0] = value
    mujoco.mj_kinematics(model, data)


@pytest.mark.parametrize("pose", ["qpos0", "home"])
def test_the_flange_is_where_it_was_published(fr3: mujoco.MjModel, figures: Figures, pose: str) -> None:
    published = figures["fr3"]["published_flange"][pose]
    data = mujoco.MjData(fr3)
    set_joints(fr3, data, np.array(published["q"]))
    flange = data.site(FR3.flange_site)
    np.testing.assert_allclose(flange.xpos, published["position"], atol=1e-12)
    np.testing.assert_allclose(flange.xmat, published["rotation"], atol=1e-12)


def test_masses_and_inertias_equal_the_table(
    fr3: mujoco.MjModel, figures: Figures, inertia_in_body: Callable[[mujoco.MjModel, str], NDArray[np.float64]]
) -> None:
    for link in figures["fr3"]["links"]:
        body = fr3.body(link["link"])
        assert body.mass[0] == link["mass"]
        np.testing.assert_array_equal(body.ipos, link["com"])
        np.testing.assert_allclose(inertia_in_body(fr3, link["link"]), link["inertia_xx_yy_zz_xy_xz_yz"], atol=1e-12)


def test_limits_and_joint_dynamics_equal_the_table_in_model_and_description(
    fr3: mujoco.MjModel, figures: Figures
) -> None:
    for i, row in enumerate(figures["fr3"]["limits"]):
        joint = fr3.joint(FR3.joints[i])
        assert [FR3.joint_lower[i], FR3.joint_upper[i]] == row["range"] == list(joint.range)
        assert FR3.effort_limit[i] == row["effort"]
        np.testing.assert_array_equal(fr3.jnt_actfrcrange[joint.id], [-row["effort"], row["effort"]])
        assert FR3.velocity_limit[i] == row["velocity"]
        for name in ("armature", "damping", "frictionloss"):
            assert getattr(joint, name)[0] == row[name]


def test_servo_gains_equal_the_table(fr3: mujoco.MjModel, figures: Figures) -> None:
    for name, row in zip(FR3.actuators, figures["fr3"]["limits"], strict=True):
        actuator = fr3.actuator(name)
        assert actuator.gainprm[0] == row["kp"]
        np.testing.assert_array_equal(actuator.biasprm[:3], [0.0, -row["kp"], -row["kv"]])
        np.testing.assert_array_equal(actuator.ctrlrange, row["range"])


def test_at_home_the_tcp_points_down_and_nothing_touches(
    lab: mujoco.MjModel, at_home: Callable[[mujoco.MjModel], mujoco.MjData]
) -> None:
    data = at_home(lab)
    assert data.ncon == 0
    np.testing.assert_allclose(data.site("hand/tcp").xmat.reshape(3, 3), np.diag([1.0, -1.0, -1.0]), atol=1e-9)


def test_no_pair_of_links_touches_in_more_than_a_fiftieth_of_all_poses(lab: mujoco.MjModel) -> None:
    # A pair whose shapes overlap by construction would touch in every pose, or in every pose of one joint.
    rng = np.random.default_rng(3)
    data = mujoco.MjData(lab)
    poses = rng.uniform(FR3.joint_lower, FR3.joint_upper, (500, FR3.dof))
    touching: dict[tuple[int, int], int] = {}
    for q in poses:
        set_joints(lab, data, q, prefix="arm/")
        mujoco.mj_collision(lab, data)
        bodies = lab.geom_bodyid[data.contact.geom]
        for pair in {(int(a), int(b)) for a, b in bodies}:
            touching[pair] = touching.get(pair, 0) + 1
    assert max(touching.values()) < len(poses) / 50


def test_a_folded_arm_touches_itself(lab: mujoco.MjModel) -> None:
    data = mujoco.MjData(lab)
    set_joints(lab, data, np.array([0.0, -1.7, 0.0, -3.0, 0.0, 0.6, 0.0]), prefix="arm/")
    mujoco.mj_collision(lab, data)
    assert data.ncon > 0


def test_the_arm_rests_on_the_floor_without_touching_it() -> None:
    spec = mujoco.MjSpec.from_file(str(FR3.mjcf))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 0.1])
    model = spec.compile()
    data = mujoco.MjData(model)
    set_joints(model, data, np.array(FR3.home))
    mujoco.mj_collision(model, data)
    assert data.ncon == 0
