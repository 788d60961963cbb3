from __future__ import annotations

import rcs
from rcs.envs.observers.dataset_info import bounds_of_joints, dataset_info
from rcs.robots.fr3 import FR3


def test_a_recording_knows_the_limits_of_its_arm() -> None:
    with rcs.make("PickCuboid", robot="fr3", cameras=()) as env:
        info = dataset_info(env)
    assert info.feature("observation/joints").limits == bounds_of_joints(FR3)
    assert info.feature("observation/joint_velocities").limits is None


def test_the_arms_of_a_lab_are_known_by_the_names_in_its_keys() -> None:
    with rcs.make("LiftBar", robot="dual_fr3", cameras=()) as env:
        info = dataset_info(env)
    limited = [feature.key for feature in info.features if feature.limits is not None]
    assert limited == ["observation/left/joints", "observation/right/joints"]
