from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from rcs.kinematics import kinematics_of, load
from rcs.robots.fr3.description import FR3


def add_tip(spec: mujoco.MjSpec) -> None:
    spec.body("link7").add_site(name="tip", pos=[0.0, 0.0, 0.3])


def test_a_model_is_completed_each_time_it_is_read() -> None:
    arm = dataclasses.replace(FR3, complete=add_tip)
    for _ in range(2):
        assert load(arm).site("tip") is not None
    assert load(FR3).site("tip") is None


def test_kinematics_know_what_was_added() -> None:
    arm = dataclasses.replace(FR3, complete=add_tip, flange_site="tip")
    home = np.array(FR3.home)
    rise = kinematics_of(FR3).forward(home).translation - kinematics_of(arm).forward(home).translation
    assert abs(rise[2] - (0.3 - 0.107)) < 1e-9  # the hand points down; the flange is 0.107 m beyond link7
