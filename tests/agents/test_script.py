"""Scripts go through their phases in order, on all arms in step, and try again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rcs
from rcs.agents import LiftExpert
from rcs.agents.script import PATIENCE, Phase, Plan, Script, ScriptedArm


def raised(arm: ScriptedArm, height: float) -> NDArray[np.float64]:
    tcp = arm.kinematics.forward(arm.start).tquat
    tcp[2] += height
    return tcp


class Wave(Script):
    task = "Free"
    needs = ()
    phases = (Phase("up", "high", 0.1), Phase("down", "home", 0.1), Phase("stay", "home", opening=0.0))

    def plan(self, arm: ScriptedArm) -> Plan | None:
        return {"high": raised(arm, 0.05)}


def run(env: Any, script: Script, steps: int, seed: int = 0) -> tuple[list[str], list[Any]]:
    """Return the phase and the observation of each step."""
    observation, info = env.reset(seed=seed)
    script.reset(observation, info)
    phases, seen = [], [observation]
    for _ in range(steps):
        observation, _, _, _, info = env.step(script.act(observation, info))
        phases.append(script.phase)
        seen.append(observation)
    return phases, seen


def in_order(phases: list[str]) -> list[str]:
    return list(dict.fromkeys(phases))


def test_phases_come_in_order_and_the_last_one_stays() -> None:
    env = rcs.make("Free", robot="fr3")
    script = Wave(env)
    phases, seen = run(env, script, 90)
    assert in_order(phases) == ["up", "down", "stay"]
    assert phases == sorted(phases, key=["up", "down", "stay"].index)
    heights = np.array([observation["tquat"][2] for observation in seen])
    assert heights.max() - heights[0] == pytest.approx(0.05, abs=5e-3)
    assert heights[-1] == pytest.approx(heights[0], abs=2e-3)
    assert seen[-1]["gripper"][0] < 0.1
    assert script.failure is None


def test_a_target_is_no_faster_than_its_phase_says() -> None:
    env = rcs.make("Free", robot="fr3", control="tquat", relative=False)
    script = Wave(env)
    observation, info = env.reset(seed=0)
    script.reset(observation, info)
    last = observation["tquat"]
    for _ in range(60):
        action = script.act(observation, info)
        assert np.linalg.norm(action["tquat"][:3] - last[:3]) <= 0.1 / 30 + 1e-9
        last = action["tquat"]
        observation, _, _, _, info = env.step(action)


def test_a_phase_that_never_gets_done_ends_some_time_after_its_targets_are_at_the_goal() -> None:
    class Wait(Wave):
        phases = (Phase("wait", "home", until=lambda script: False), Phase("after", "home"))

    env = rcs.make("Free", robot="fr3")
    phases, _ = run(env, Wait(env), round(PATIENCE * 30) + 5)
    assert phases.count("wait") == pytest.approx(PATIENCE * 30, abs=2)


@pytest.mark.parametrize("stepping", ["async", "sync"])
def test_a_phase_that_is_under_way_is_not_cut_short_however_long_it_takes(stepping: Any) -> None:
    class Slow(Wave):
        phases = (Phase("up", "high", 0.05 / (2 * PATIENCE)), Phase("stay", "high"))

    env = rcs.make("Free", robot="fr3", stepping=stepping, max_episode_steps=None)
    script = Slow(env)
    observation, info = env.reset(seed=0)
    script.reset(observation, info)
    while script.phase == "up":
        observation, _, _, _, info = env.step(script.act(observation, info))
    high = script.arms[0].plan["high"]
    np.testing.assert_allclose(observation["tquat"][:3], high[:3], atol=5e-3)


def test_elapsed_time_is_that_of_the_environment_and_not_a_count_of_steps() -> None:
    for stepping in ("async", "sync"):
        env = rcs.make("Free", robot="fr3", stepping=stepping)
        script = Wave(env)
        observation, info = env.reset(seed=0)
        script.reset(observation, info)
        for _ in range(2):
            observation, _, _, _, info = env.step(script.act(observation, info))
        script.act(observation, info)
        assert script.phase == "up"
        assert script.elapsed == pytest.approx(info["time"])


@pytest.mark.parametrize("attempts", [1, 3])
def test_a_failing_script_tries_as_often_as_it_should_and_says_why_it_gave_up(attempts: int) -> None:
    class Clumsy(Wave):
        phases = (Phase("up", "high", 0.5), Phase("drop", "high", risk=("slip", lambda script: True)))

    Clumsy.attempts = attempts
    env = rcs.make("Free", robot="fr3", max_episode_steps=None)
    script = Clumsy(env)
    phases, seen = run(env, script, 200)
    changes = [now for before, now in zip(["", *phases], phases, strict=False) if now != before]
    assert changes.count("drop") == attempts
    assert changes.count("retreat") == attempts - 1
    assert changes[-1] == "given up"
    assert script.failure == "slip"
    np.testing.assert_allclose(seen[-1]["joints"], seen[-10]["joints"], atol=1e-3)
    run(env, script, 1)
    assert script.failure is None, "a new episode begins without a failure"


def test_a_plan_that_is_not_feasible_moves_nothing() -> None:
    class Lost(Wave):
        def plan(self, arm: ScriptedArm) -> Plan | None:
            return None

    env = rcs.make("Free", robot="fr3")
    script = Lost(env)
    phases, seen = run(env, script, 20)
    assert set(phases) == {"given up"}
    assert script.failure == "ik"
    np.testing.assert_allclose(seen[-1]["joints"], seen[0]["joints"], atol=2e-3)


def test_several_arms_wait_for_each_other() -> None:
    class Uneven(Wave):
        def plan(self, arm: ScriptedArm) -> Plan | None:
            return {"high": raised(arm, 0.02 if arm is self.arms[0] else 0.10)}

    env = rcs.make("Free", robot="dual_fr3")
    script = Uneven(env)
    phases, seen = run(env, script, 60)
    last_up = phases.index("down")
    left, right = (np.array([observation[name]["tquat"][2] for observation in seen]) for name in env.robots)
    assert left[last_up] - left[0] == pytest.approx(0.02, abs=5e-3)
    assert right[last_up] - right[0] == pytest.approx(0.10, abs=5e-3)


def test_both_arms_of_the_lift_expert_close_at_the_same_step() -> None:
    env = rcs.make("LiftBar", robot="dual_fr3")
    expert = LiftExpert(env)
    observation, info = env.reset(seed=1)
    expert.reset(observation, info)
    is_over = False
    while not is_over:
        action = expert.act(observation, info)
        assert action["left"]["gripper"] == action["right"]["gripper"]
        observation, _, is_over, truncated, info = env.step(action)
        assert not truncated
    assert expert.phase == "lift"
