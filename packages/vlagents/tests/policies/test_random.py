from __future__ import annotations

import numpy as np
import pytest
from vlagents import InvalidInput, Metadata, Observation, PartSpec
from vlagents.policies.random import RandomPolicy
from vlagents.policies.scripted import ScriptedPolicy


def test_random_actions_are_those_of_the_session_and_its_seed() -> None:
    policy = RandomPolicy(size=3, horizon=4, rate=20.0)
    drawn = []
    for session, seed in (("a", 1), ("b", 1), ("c", 2)):
        policy.reset(session, seed=seed)
        drawn.append(policy.infer(Observation(session=session, time=2.0)))
    assert [(chunk.actions.shape, chunk.period, chunk.time) for chunk in drawn] == [((4, 3), 0.05, 2.0)] * 3
    np.testing.assert_array_equal(drawn[0].actions, drawn[1].actions)
    assert (drawn[0].actions != drawn[2].actions).all()
    assert min(chunk.actions.min() for chunk in drawn) < 0 < max(chunk.actions.max() for chunk in drawn)


def test_a_policy_of_this_package_needs_a_rate() -> None:
    with pytest.raises(InvalidInput, match="rate is 0"):
        RandomPolicy(rate=0.0)
    with pytest.raises(InvalidInput, match="rate of 'nod' is 0"):
        ScriptedPolicy(lambda seen, told: [1.0], Metadata("nod", (PartSpec("joints", 1),)))
