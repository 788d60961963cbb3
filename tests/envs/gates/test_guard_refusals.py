"""Reactions of a guard to a motion that it does not admit, and the options that decide it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs import Guard
from rcs.errors import InvalidSetup, Refused, UnknownName
from rcs.robots.fr3 import FR3
from rcs.sim.randomisation import Randomisation
from tests.envs.gates.ways import DOWN, HOME, OPEN, ask


def test_refused_all_robots_hold_and_the_episode_goes_on_or_ends_as_chosen() -> None:
    for on_hit in ("reject", "stop"):
        with rcs.make("PickCuboid", relative=False, gates={"Guard": {"on_hit": on_hit}}) as env:
            observation, _ = env.reset(seed=0)
            start = observation["joints"]
            down = {"joints": start + DOWN, "gripper": OPEN}
            truncated = False
            for _ in range(40):
                observation, _, _, truncated, info = env.step(down)
                if "refused" in info:
                    break
            assert "'table'" in info["refused"]
            assert truncated == (on_hit == "stop")
            if truncated:
                assert info["end"] == "fault"
                assert "'table'" in info["faults"]["gate"]
                continue
            for _ in range(30):
                observation, *_, info = env.step(down)
            assert env.simulation.world.data.ncon < 20
            assert observation["tquat"][2] > 0.0  # the fingers stay above the table


def test_clipped_the_arm_goes_as_far_as_it_may_and_not_farther() -> None:
    with rcs.make("PickCuboid", relative=False, max_episode_steps=None, gates={"Guard": {"on_hit": "clip"}}) as env:
        observation, _ = env.reset(seed=0)
        observation["joints"][0] += 0.6  # beside the cuboid
        down = {"joints": observation["joints"] + DOWN, "gripper": OPEN}
        fractions = []
        for _ in range(120):
            observation, *_, info = env.step(down)
            assert "refused" not in info
            fractions.append(float(info["guard_fraction"]))
        assert fractions[0] == 1.0
        assert fractions[-1] < 0.01
        assert np.abs(observation["joint_velocities"]).max() < 0.02
        scene: Any = env.stack.gates[0]._scene
        measured = {"": {"joints": observation["joints"], "gripper": observation["gripper"]}}
        q = scene.vector(measured, measured)
        assert scene.far.clearance(q, 0.05).distance > 0.009
        assert scene.near.clearance(q, 0.05).distance > 0.0005
        up, *_ = env.step({"joints": observation["joints"] - np.array([0, 0.05, 0, 0, 0, 0, 0]), "gripper": OPEN})
        assert env.stack.gates[0].info()["guard_fraction"] == 1.0
        assert up is not None


def test_copies_are_late_and_cut_as_each_would_be_alone() -> None:
    late = Randomisation.off(late_actions=0.4)
    options: dict[str, Any] = {"gates": {"Guard": {"on_hit": "clip"}}, "max_episode_steps": None, "randomisation": late}
    steps = np.zeros((3, 7))
    steps[0, 0], steps[1], steps[2, 4] = 0.02, 0.02 * DOWN, -0.02  # one alone goes down to the table
    envs = rcs.make_vec("PickCuboid", copies=3, threads=2, **options)
    envs.reset(seed=[5, 6, 7])
    rows = []
    for _ in range(60):
        observations, *_, infos = envs.step({"joints": steps, "gripper": np.ones((3, 1), np.float32)})
        rows.append((observations["joints"].copy(), infos["guard_fraction"].copy(), infos["is_late"].copy()))
    envs.close()
    assert min(fraction[1] for _, fraction, _ in rows) < 1.0
    for copy in range(3):
        with rcs.make("PickCuboid", **options) as env:
            env.reset(seed=5 + copy)
            for joints, fraction, is_late in rows:
                observation, *_, info = env.step({"joints": steps[copy], "gripper": OPEN})
                np.testing.assert_array_equal(observation["joints"], joints[copy])
                assert info["guard_fraction"] == fraction[copy]
                assert info["is_late"] == is_late[copy]


def test_copies_are_cut_as_each_would_be_alone() -> None:
    options: dict[str, Any] = {"relative": False, "gates": {"Guard": {"on_hit": "clip"}}, "max_episode_steps": None}
    random = np.random.default_rng(0)
    ways = random.normal(0, 0.7, (3, 7))
    envs = rcs.make_vec("PickCuboid", copies=3, threads=2, **options)
    observations, _ = envs.reset(seed=[5, 6, 7])
    starts = observations["joints"].copy()
    rows = []
    lower, upper = np.array(FR3.joint_lower), np.array(FR3.joint_upper)
    goals = np.clip(starts + ways, lower, upper)
    for _ in range(25):
        observations, _, _, _, infos = envs.step({"joints": goals, "gripper": np.ones((3, 1), np.float32)})
        rows.append((observations["joints"].copy(), np.array(infos["guard_fraction"])))
    envs.close()
    assert any((fraction < 1).any() for _, fraction in rows)
    for copy in range(3):
        with rcs.make("PickCuboid", **options) as env:
            env.reset(seed=5 + copy)
            for joints, fraction in rows:
                observation, *_, info = env.step({"joints": goals[copy], "gripper": OPEN})
                np.testing.assert_array_equal(observation["joints"], joints[copy])
                assert info["guard_fraction"] == fraction[copy]


@pytest.mark.parametrize("options", [{}, {"end_effector": "none"}], ids=["gripper", "flange"])
def test_the_workspace_is_a_box_that_the_end_of_an_arm_does_not_leave(options: Any) -> None:
    box = ((-0.1, -0.2, -0.1), (0.9, 0.2, 1.2))
    with rcs.make("Free", relative=False, stepping="sync", gates=[Guard(workspace=box)], **options) as env:
        env.reset(seed=0)
        assert "workspace" in str(env.limits())
        ask(env, HOME, HOME + np.array([0.15, 0, 0, 0, 0, 0, 0]))
        with pytest.raises(Refused, match="'workspace'"):
            ask(env, HOME, HOME + np.array([0.6, 0, 0, 0, 0, 0, 0]))


def test_a_check_that_is_late_or_dies_lets_nothing_through(monkeypatch: pytest.MonkeyPatch) -> None:
    guard = Guard(deadline=1e-9)
    with rcs.make("PickCuboid", gates=[guard]) as env:
        start = env.reset(seed=0)[0]["joints"]
        sent: list[Any] = []
        monkeypatch.setattr(env.stack, "send", sent.append)
        action = {"joints": np.full(7, 0.02), "gripper": OPEN}
        for _ in range(5):
            observation, *_, info = env.step(action)
            assert "deadline" in info["refused"]
        np.testing.assert_allclose(observation["joints"], start, atol=2e-3)

        def die(*_: Any) -> None:
            raise RuntimeError("out of memory")

        monkeypatch.setattr(guard, "_sweep", die)
        with pytest.raises(RuntimeError, match="out of memory"):
            env.step(action)
        np.testing.assert_allclose(env.simulation.robots[0].joints, start, atol=2e-3)
        assert not sent


def test_a_guard_is_part_of_the_setup_by_its_name_with_its_options() -> None:
    with rcs.make("PickCuboid", gates={"Guard": {"on_hit": "clip", "margin": 0.02}}) as env:
        assert rcs.Setup.from_json(env.setup.to_json()) == env.setup
        assert env.setup.gates == {"Guard": {"on_hit": "clip", "margin": 0.02}}
        with rcs.make(env.setup) as again:
            assert str(again.stack.gates[0]) == str(env.stack.gates[0]) == "Guard: clip, margin 20 mm, near 1 mm"
    with rcs.make("Free", gates=[Guard]) as env:
        assert env.setup.gates == {"Guard": {}}


@pytest.mark.parametrize(
    ("gates", "error", "words"),
    [
        ([Guard, "Gaurd"], UnknownName, "Gaurd"),
        ("Guard", InvalidSetup, "is the text"),
        ({"Guard": {"marign": 1}}, InvalidSetup, "argument 'marign'.*; valid options: on_hit, margin"),
        ({"Guard": {"margin": "wide"}}, InvalidSetup, "'margin': 'wide'.*: '<=' not supported between"),
        ({"Guard": {"on_hit": "ring"}}, InvalidSetup, "'reject', 'clip', 'stop'"),
        ({"Guard": {"margin": 0.001, "near_margin": 0.01}}, InvalidSetup, "near_margin <= margin"),
        ({"Guard": {"touch": ["cupoid"]}}, InvalidSetup, "no body 'cupoid'"),
        ({"Guard": {"workspace": [[0, 0, 0], [0, 1, 1]]}}, InvalidSetup, "highest corner"),
        ({"Guard": {"deadline": 0}}, InvalidSetup, "deadline is 0"),
        ({"Guard": {"allow": ["table"]}}, InvalidSetup, "pairs of names"),
        ({"rcs.errors:Refused": {}}, InvalidSetup, "subclass of rcs.envs.Gate"),
    ],
)
def test_options_that_make_no_sense_are_refused(gates: Any, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        rcs.make("PickCuboid", gates=gates)


def test_copies_cannot_be_refused_one_by_one() -> None:
    with pytest.raises(InvalidSetup, match="on_hit='clip'"):
        rcs.make_vec("PickCuboid", copies=2, gates=["Guard"])
