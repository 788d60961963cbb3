"""Commands of chunks at any time: functions of time, shares of motions, blends and means."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcs.errors import InvalidSetup
from rcs.policy.plan import NEAR, ChunkPlan, Part, averaged, blended
from rcs.spatial import compose, distance, inverse, normalize, xyzrpy_to_tquat

JOINTS = Part("joints", slice(0, 3), "linear")
STEPS = Part("joints", slice(0, 3), "linear", is_difference=True)
SLOPE = np.array([0.3, -0.2, 0.1])


def line(time: float) -> np.ndarray:
    return np.array([1.0, 2.0, 3.0]) + SLOPE * time


def targets(begin: float, period: float, count: int) -> ChunkPlan:
    """Return a chunk whose rows lie on the line, each at the end of its time, and whose start does too."""
    rows = np.array([line(begin + (i + 1) * period) for i in range(count)])
    return ChunkPlan([JOINTS], rows, time=begin, period=period, start={"joints": line(begin)})


@settings(deadline=None, max_examples=40)
@given(rate=st.floats(2, 60), loop=st.floats(5, 200), begin=st.floats(-5, 5), late=st.floats(0, 1))
def test_rows_on_a_line_give_that_line_at_any_rates_and_however_late_one_begins(
    rate: float, loop: float, begin: float, late: float
) -> None:
    plan, rounding = targets(begin, 1 / rate, 12), NEAR / rate * np.abs(SLOPE).max()
    time = begin + late * 0.5 * (plan.end - begin)
    while time < plan.end - 1 / loop:
        command = plan.at(time, 1 / loop)
        assert command is not None
        np.testing.assert_allclose(command["joints"], line(time + 1 / loop), atol=1e-9 + rounding)
        time += 1 / loop


def test_at_the_policys_own_rate_the_rows_are_given_bit_for_bit() -> None:
    rows = np.random.default_rng(0).normal(size=(30, 3))
    plan = ChunkPlan([JOINTS], rows, time=0.7, period=1 / 30)
    for i in range(30):
        command = plan.at(0.7 + i / 30, 1 / 30)
        assert command is not None
        assert np.array_equal(command["joints"], rows[i])


def test_there_is_nothing_before_a_chunk_and_nothing_after_it() -> None:
    plan = targets(1.0, 0.1, 5)
    assert plan.at(0.99, 0.1) is None
    assert plan.at(1.5, 0.1) is None
    assert plan.at(1.0, 0.1) is not None
    assert plan.at(1.49, 0.1) is not None


@settings(deadline=None, max_examples=40)
@given(rate=st.integers(2, 60), loop=st.integers(5, 200))
def test_shares_of_motions_add_up_to_the_motions(rate: int, loop: int) -> None:
    rows = np.random.default_rng(rate).normal(size=(12, 3))
    plan = ChunkPlan([STEPS], rows, time=0.0, period=1 / rate)
    total, count = np.zeros(3), math.ceil(plan.end * loop)
    for i in range(count):
        command = plan.at(i / loop, 1 / loop)
        if command is not None:
            total += command["joints"]
    np.testing.assert_allclose(total, rows.sum(axis=0), atol=1e-4)


def test_shares_of_a_pose_motion_make_the_motion() -> None:
    part = Part("tquat", slice(0, 7), "pose", is_difference=True)
    motion = xyzrpy_to_tquat(np.array([0.1, -0.2, 0.05, 0.4, -0.3, 0.9]))
    plan = ChunkPlan([part], motion[None], time=0.0, period=0.2)
    shares = [plan.at(i / 30, 1 / 30) for i in range(6)]
    total = part.joined([share["tquat"] for share in shares if share is not None])
    np.testing.assert_allclose(total, motion, atol=1e-9)


def test_poses_turn_at_constant_speed_between_rows() -> None:
    part = Part("tquat", slice(0, 7), "pose")
    start, end = (xyzrpy_to_tquat(np.array([0.4, 0.0, 0.3, 0.0, 0.0, yaw])) for yaw in (0.0, 0.8))
    plan = ChunkPlan([part], end[None], time=0.0, period=0.2, start={"tquat": start})
    angles = [distance(start, plan.at(i / 30, 1 / 30)["tquat"])[1] for i in range(6)]  # type: ignore[index]
    np.testing.assert_allclose(np.diff([0.0, *angles]), 0.8 / 6, atol=1e-9)


def test_a_grippers_opening_is_never_between_two_rows() -> None:
    part = Part("gripper", slice(0, 1), "opening")
    plan = ChunkPlan([part], np.array([[1.0], [0.0]]), time=0.0, period=0.2)
    openings = [float(plan.at(i / 30, 1 / 30)["gripper"][0]) for i in range(12)]  # type: ignore[index]
    assert openings == [1.0] * 6 + [0.0] * 6


def test_units_and_conventions_are_converted() -> None:
    part = Part("gripper", slice(2, 3), "opening", scale=-0.5, offset=0.5)  # -1 open, 1 closed
    actions = np.array([[9.0, 9.0, -1.0], [9.0, 9.0, 1.0]])
    rows = part.read(actions, None)
    assert rows.tolist() == [[1.0], [0.0]]


def test_rows_that_count_from_the_start_are_targets_from_there() -> None:
    joints = Part("joints", slice(0, 3), "linear", counts_from_start=True)
    pose = Part("tquat", slice(3, 10), "pose", counts_from_start=True)
    start = {"joints": np.array([1.0, 2.0, 3.0]), "tquat": xyzrpy_to_tquat(np.array([0.4, 0.1, 0.3, 3.0, 0.1, 0.2]))}
    motion = xyzrpy_to_tquat(np.array([0.01, 0.02, -0.03, 0.1, 0.0, -0.2]))
    actions = np.concatenate([[0.1, 0.2, -0.3], motion])[None]
    plan = ChunkPlan([joints, pose], actions, time=0.0, period=0.1, start=start)
    command = plan.at(0.0, 0.1)
    assert command is not None
    np.testing.assert_allclose(command["joints"], [1.1, 2.2, 2.7])
    np.testing.assert_allclose(command["tquat"][:3], start["tquat"][:3] + motion[:3])
    # The motion turns about the axes of the base frame: what is left after taking the start away is the motion.
    turned = compose(np.array([0, 0, 0, *command["tquat"][3:]]), inverse(np.array([0, 0, 0, *start["tquat"][3:]])))
    np.testing.assert_allclose(normalize(turned)[3:], normalize(motion)[3:], atol=1e-9)


def wave(begin: float, shift: float, count: int = 30, period: float = 0.05) -> ChunkPlan:
    moments = begin + period * (1 + np.arange(count))
    return ChunkPlan([JOINTS], np.sin(3 * moments[:, None] + shift + np.arange(3)), time=begin, period=period)


@settings(deadline=None, max_examples=40)
@given(shift=st.floats(-3, 3), loop=st.integers(10, 120))
def test_a_blend_never_jumps(shift: float, loop: float) -> None:
    old, new = wave(0.0, 0.0), wave(0.5, shift)
    since, until, period = 0.8, old.end, 1 / loop
    new.since, new.until = since, until
    moments = since + period * np.arange(int((until - since) * loop))
    values = {name: np.array([blended(plans, t, period)["joints"] for t in moments])  # type: ignore[index]
              for name, plans in (("old", [old]), ("new", [new]), ("blend", [old, new]))}  # fmt: skip
    assert np.array_equal(values["blend"][0], values["old"][0])
    apart = np.abs(values["old"] - values["new"]).max()
    own = max(np.abs(np.diff(values[name], axis=0)).max() for name in ("old", "new"))
    steepest = (2 * math.e - 1) / (math.e - 1)  # the largest slope of the weight
    bound = own + steepest * period / (until - since) * apart
    assert np.abs(np.diff(values["blend"], axis=0)).max() <= bound + 1e-9


def test_a_blend_ends_as_the_new_chunk_alone() -> None:
    old, new = wave(0.0, 0.0), wave(0.5, 1.0)
    new.since, new.until = 0.8, old.end
    command = blended([old, new], old.end, 0.05)
    assert np.array_equal(command["joints"], new.at(old.end, 0.05)["joints"])  # type: ignore[index]
    assert [new.weight_before(t) for t in (0.8, old.end)] == [1.0, 0.0]


def test_an_ensemble_is_the_closed_form_of_act() -> None:
    plans = [wave(begin, shift) for begin, shift in ((0.0, 0.0), (0.2, 0.3), (0.4, -0.2), (0.6, 0.5))]
    time, period, decay = 0.75, 1 / 30, 0.1
    weights = np.exp(-decay * np.arange(4))
    rows = np.array([plan.at(time, period)["joints"] for plan in plans])  # type: ignore[index]
    command = averaged(plans, time, period, decay=decay)
    assert command is not None
    np.testing.assert_allclose(command["joints"], weights @ rows / weights.sum())


def test_an_ensemble_counts_only_chunks_that_speak_of_the_moment() -> None:
    plans = [wave(0.0, 0.0, count=4), wave(0.1, 1.0)]
    late = averaged(plans, 0.5, 0.05, decay=0.1)
    assert late is not None
    assert np.array_equal(late["joints"], plans[1].at(0.5, 0.05)["joints"])  # type: ignore[index]


def test_rotations_are_averaged_on_one_side() -> None:
    part = Part("tquat", slice(0, 7), "pose")
    a = xyzrpy_to_tquat(np.array([0.0, 0.0, 0.0, np.pi - 0.1, 0.0, 0.0]))
    b = xyzrpy_to_tquat(np.array([0.0, 0.0, 0.0, -np.pi + 0.1, 0.0, 0.0]))
    middle = part.mean([a, b], [0.5, 0.5])
    np.testing.assert_allclose(distance(a, middle)[1], 0.1, atol=1e-9)
    np.testing.assert_allclose(distance(b, middle)[1], 0.1, atol=1e-9)


@pytest.mark.parametrize(("actions", "period"), [(np.full((2, 3), np.nan), 0.1), (np.zeros((2, 3)), 0.0)])
def test_what_is_not_finite_never_becomes_a_plan(actions: np.ndarray, period: float) -> None:
    with pytest.raises(InvalidSetup, match="not finite"):
        ChunkPlan([JOINTS], actions, time=0.0, period=period)


def test_the_opening_at_the_very_end_of_a_chunk_is_that_of_its_last_row() -> None:
    plan = ChunkPlan([Part("gripper", slice(0, 1), "opening")], np.arange(4.0)[:, None], time=0.0, period=1.0)
    command = plan.at(4 - 1.5e-6, 1.0)
    assert command is not None
    assert command["gripper"].tolist() == [3.0]
