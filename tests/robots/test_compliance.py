"""Valid options of a compliance, and what they come to for an arm."""

from __future__ import annotations

import json
import pickle
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.kinematics.chain import damped
from rcs.robots import FR3, FRANKA_HAND, SO101, SO101_GRIPPER, Compliance
from rcs.sim.randomisation import Randomisation

GIVEN = [
    Compliance(joints=100.0),
    Compliance(joints=(1, 2, 3, 4, 5, 6, 7), damping=3),
    Compliance(joints=np.full(7, 50.0), damping=[1] * 7),  # pyright: ignore[reportArgumentType]
    Compliance(tcp=(500, 30)),
    Compliance(tcp=(500, 400, 300, 30, 20, 10), damping=(40.0, 3.0)),
]


@pytest.mark.parametrize("given", GIVEN, ids=str)
def test_json_and_pickle_give_the_same_compliance_back_alone_and_in_a_setup(given: Compliance) -> None:
    assert Compliance.from_json(json.loads(json.dumps(given.to_json()))) == given
    assert pickle.loads(pickle.dumps(given)) == given
    setup = Setup(compliance=given)
    assert Setup.from_json(json.loads(json.dumps(setup.to_json()))) == setup
    assert hash(setup) == hash(Setup.from_json(setup.to_json())) != hash(Setup())


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({}, "got neither"),
        ({"joints": 1.0, "tcp": (1, 1)}, "got both"),
        ({"joints": 0.0}, "joints is 0.0; valid: a sequence, each a finite number above 0"),
        ({"joints": -5}, "above 0"),
        ({"joints": (100, float("nan"))}, "finite"),
        ({"joints": float("inf")}, "finite"),
        ({"joints": True}, "finite number"),
        ({"joints": "stiff"}, "finite number"),
        ({"joints": ()}, "finite number"),
        ({"tcp": 500}, "tcp has 1 numbers; those of the TCP are two"),
        ({"tcp": (1, 2, 3)}, "tcp has 3 numbers"),
        ({"tcp": (500, -1)}, "above 0"),
        ({"tcp": (500, 30), "damping": (1, 2, 3)}, "damping has 3 numbers"),
        ({"joints": 10, "damping": -1}, "damping is -1; valid: a sequence, each a finite number from 0"),
    ],
)
def test_what_makes_no_sense_is_refused(given: Any, match: str) -> None:
    with pytest.raises(InvalidSetup, match=match):
        Compliance(**given)


def test_an_unknown_field_and_another_type_are_refused() -> None:
    with pytest.raises(InvalidSetup, match="Did you mean 'joints'"):
        Compliance.from_json({"jionts": 100})
    with pytest.raises(InvalidSetup, match="Compliance"):
        Setup(compliance=100)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("given", [Compliance(joints=(1, 2, 3)), Compliance(joints=100, damping=(1, 2, 3))])
def test_another_number_of_joints_is_refused_with_the_arm(given: Compliance) -> None:
    with pytest.raises(InvalidSetup, match=r"3 numbers; valid for Franka Research 3 is one, or 7"):
        rcs.make("Free", robot="fr3", compliance=given)


def test_springs_of_a_tcp_are_refused_together_with_late_actions() -> None:
    soft = Compliance(tcp=(500, 30))
    with pytest.raises(InvalidSetup, match="action_latency"):
        Setup(compliance=soft, randomisation=Randomisation())
    Setup(compliance=soft, randomisation=Randomisation(action_latency=(0.0, 0.0)))
    Setup(compliance=Compliance(joints=100), randomisation=Randomisation())


def test_what_is_given_counts_and_the_rest_is_critical_damping() -> None:
    own = damped(Compliance(joints=100, damping=3), FR3, FRANKA_HAND)
    assert (own.joints, own.damping) == ((100.0,) * 7, (3.0,) * 7)
    assert damped(own, FR3, None) == own
    for stiffer in (1.0, 4.0):
        one = damped(Compliance(tcp=(500 * stiffer, 30 * stiffer)), FR3, FRANKA_HAND).damping
        usual = damped(Compliance(tcp=(500, 30)), FR3, FRANKA_HAND).damping
        np.testing.assert_allclose(one, np.sqrt(stiffer) * np.array(usual))
    light, heavy = (damped(Compliance(joints=20), SO101, gripper).damping for gripper in (None, SO101_GRIPPER))
    assert np.all(np.array(light) <= np.array(heavy)), "what an arm carries is damped, too"
