from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rcs.envs.layers import NativeTwist
from rcs.envs.spaces import TQUAT, TWIST
from rcs.spatial import Pose, xyzrpy_to_tquat

BOUND = np.repeat([0.5, 2.0], 3)
START = xyzrpy_to_tquat([[0.4, 0.1, 0.3, 3.0, 0.2, 0.1], [0.3, 0.0, 0.5, 2.0, 0.0, 1.0]])
TWISTS = arrays(np.float64, (2, 6), elements=st.floats(-4.0, 4.0))


def layer(start: Any) -> NativeTwist:
    made = NativeTwist(20.0)
    made.action_spaces({TWIST: spaces.Box(-BOUND, BOUND, dtype=np.float64)})
    made.reset({TQUAT: start})
    return made


@settings(max_examples=100, deadline=None)
@given(asked=TWISTS)
def test_what_is_too_fast_is_slowed_down_in_its_direction(asked: Any) -> None:
    one = layer(START)
    sent = one.map_action({TWIST: asked})[TWIST]
    assert (np.abs(sent) <= BOUND + 1e-12).all()
    share = (sent * asked).sum(axis=-1) / np.maximum((asked * asked).sum(axis=-1), 1e-300)
    np.testing.assert_allclose(sent, share[:, None] * asked, atol=1e-12)
    one.map_executed({TWIST: sent})
    is_fast = (np.abs(asked) > BOUND).any(axis=-1)
    np.testing.assert_array_equal(one.info()["is_limited"], is_fast)
    np.testing.assert_array_equal(sent[~is_fast], asked[~is_fast])


@settings(max_examples=50, deadline=None)
@given(twists=TWISTS)
def test_the_target_is_where_the_twist_takes_the_tcp_in_a_period(twists: Any) -> None:
    executed = layer(START).map_executed({TWIST: twists, "gripper": np.ones((2, 1))})
    assert executed.keys() == {TQUAT, "gripper"}
    for start, twist, found in zip(START, twists, executed[TQUAT], strict=True):
        turn = Pose.from_rotvec([0.0, 0.0, 0.0], twist[3:] / 20.0)
        expected = Pose(start[:3] + twist[:3] / 20.0, (turn * Pose((0, 0, 0), start[3:])).quaternion)
        assert Pose.from_tquat(found).is_close(expected, 1e-9, 1e-9)
