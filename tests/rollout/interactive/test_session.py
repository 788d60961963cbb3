"""A session: episodes by seed, steps, the end of an episode, faults, the expert."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup, SimulationError, UnknownName
from rcs.rollout.interactive.session import Session, playable


def session_of(task: str = "PickCuboid", robot: str = "fr3", **options: Any) -> Session:
    return Session(replace(playable(Setup(task=task, robot=robot, **options)), stepping="async"))


def cuboid(session: Session) -> np.ndarray:
    return session.env.simulation.object_poses()["cuboid"]


def test_what_a_person_plays_with_is_in_real_time_and_has_no_limit_of_steps() -> None:
    setup = playable(Setup(task="PickCuboid"))
    assert (setup.stepping, setup.max_episode_steps, setup.binary_gripper) == ("realtime", None, False)
    assert playable(Setup(task="PickToy", robot="xarm7")).binary_gripper
    with pytest.raises(UnknownName, match="Did you mean 'fr3'"):
        playable(Setup(robot="fr4"))


def test_a_seed_begins_the_same_episode_and_without_one_the_next() -> None:
    with session_of() as session:
        first = cuboid(session)
        session.step()
        session.reset()
        assert (session.seed, session.steps) == (1, 0)
        assert np.abs(cuboid(session) - first).max() > 1e-3
        session.reset(0)
        np.testing.assert_array_equal(cuboid(session), first)


def test_only_what_is_played_goes_on_by_itself_and_a_step_is_one_control_period() -> None:
    with session_of() as session:
        session.is_playing = False
        assert not session.advance()
        assert (session.verdict, float(session.world.time)) == ("paused", 0.0)
        session.step()
        assert float(session.world.time) == pytest.approx(1 / 30, abs=0.002)
        session.is_playing = True
        assert session.advance()
        assert (session.verdict, session.steps) == ("running", 2)


def test_the_expert_brings_the_episode_to_its_end_and_a_reset_begins_the_next() -> None:
    with session_of(reward="sparse") as session:
        session.let_agent(True)
        while not session.is_over:
            session.step()
            assert session.steps < 600
        assert session.verdict == "success"
        assert session.reward == 1.0
        steps = session.steps
        session.step()
        assert session.steps == steps
        session.reset()
        assert (session.verdict, session.seed) == ("running", 1)


def test_taking_over_from_the_expert_stays_where_the_arm_is() -> None:
    with session_of() as session:
        session.let_agent(True)
        for _ in range(20):
            session.step()
        session.let_agent(False)
        before = session.guides["fr3"].tcp_in_scene
        for _ in range(30):
            session.step()
        assert np.abs(session.guides["fr3"].tcp_in_scene - before).max() < 0.05
        assert session.guides["fr3"].opening == pytest.approx(1.0, abs=0.02)


def test_a_task_without_an_expert_says_so_and_goes_on() -> None:
    with session_of("Free") as session:
        with pytest.raises(InvalidSetup, match="no scripted expert"):
            session.let_agent(True)
        session.step()
        assert session.steps == 1


def test_an_error_of_a_step_is_told_and_a_recovery_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    with session_of() as session:

        def fail(action: Any) -> Any:
            raise SimulationError("no memory for contacts")

        with monkeypatch.context() as broken:
            broken.setattr(session.env, "step", fail)
            session.step()
        assert (session.problem, session.verdict) == ("SimulationError: no memory for contacts", "stopped")
        assert not session.advance()
        session.recover()
        assert (session.problem, session.verdict, session.seed) == ("", "running", 0)
        session.step()
        assert session.steps == 1


def test_after_a_fault_a_recovery_goes_on_where_everything_is(monkeypatch: pytest.MonkeyPatch) -> None:
    with session_of() as session:
        session.guides["fr3"].lead_joints_to(session.guides["fr3"].joints + 0.2)
        for _ in range(40):
            session.step()
        with monkeypatch.context() as broken:
            broken.setattr(session.env.stack, "faults", lambda: {"fr3": "collision at joint 4"})
            session.step()
        assert "fr3: collision at joint 4" in session.problem
        assert session.is_over
        state, place = session.world.states().copy(), session.observation["joints"]
        session.recover()
        assert session.verdict == "running"
        np.testing.assert_array_equal(session.world.states(), state)
        for _ in range(15):
            session.step()
        np.testing.assert_allclose(session.observation["joints"], place, atol=0.02)


def test_a_simulation_that_diverges_is_told_and_begins_anew() -> None:
    with session_of() as session:
        session.world.qvel[...] = 1e12
        session.step()
        assert session.verdict == "stopped"
        assert "simulation" in session.problem
        session.recover()
        assert (session.verdict, session.steps) == ("running", 0)
        assert np.isfinite(session.world.qpos).all()


def test_a_setup_that_cannot_be_made_leaves_nothing_open() -> None:
    with pytest.raises(UnknownName, match="PickCubiod"):
        Session(Setup(task="PickCubiod"))
