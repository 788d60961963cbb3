"""A session: episodes by seed, steps, the end of an episode, faults, the expert."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

from rcs.agents import Agent, Event
from rcs.envs import Env
from rcs.envs.observers.recorder import Recorder
from rcs.envs.setup import Setup
from rcs.errors import DatasetError, DeviceFault, InvalidSetup, SimulationError, UnknownName, WrongOrder
from rcs.rollout.interactive.session import Session, playable
from rcs.setups.make import make
from rcs.teleop import Operator, Takeover
from tests.rollout.asking import Asking
from tests.teleop.scripted_device import LEVEL, ScriptedDevice, held


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


def test_a_session_may_take_an_environment_and_closes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    env = make(replace(playable(Setup(task="Free")), stepping="async"))
    close, closed = env.close, list[Env]()

    def note() -> None:
        closed.append(env)
        close()

    monkeypatch.setattr(env, "close", note)
    with Session(env) as session:
        session.step()
        assert session.env is env
        assert not closed
    assert closed


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


def test_what_the_expert_holds_does_not_fall_when_the_page_takes_over() -> None:
    with session_of() as session:
        session.let_agent(True)
        table = cuboid(session)[2]
        while cuboid(session)[2] < table + 0.04:
            session.step()
            assert session.steps < 600
        session.let_agent(False)
        assert session.guides["fr3"].opening == 0.0  # not as far open as it is measured around the cuboid
        for _ in range(60):
            session.step()
        assert not session.is_over
        assert cuboid(session)[2] > table + 0.03


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
        session.guides["fr3"].opening = 0.0  # it has begun to close when the fault comes
        session.step()
        with monkeypatch.context() as broken:
            broken.setattr(session.env.stack, "faults", lambda: {"fr3": "collision at joint 4"})
            session.step()
        assert "fr3: collision at joint 4" in session.problem
        assert session.is_over
        state, place = session.world.states().copy(), session.observation["joints"]
        session.recover()
        assert session.verdict == "running"
        assert session.guides["fr3"].opening == 0.0
        assert session.observation["gripper"][0] > 0.3
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


@pytest.mark.parametrize(
    ("event", "verdict", "seed", "acts"),
    [("stop", "over", 0, True), ("reset", "running", 1, True), ("takeover", "running", 0, False)],
)
def test_an_agent_acts_at_its_own_rate_and_what_it_asks_for_is_done(
    event: Event, verdict: str, seed: int, acts: bool
) -> None:
    setup = replace(playable(Setup(task="Free", relative="absolute")), stepping="async")
    with Session(setup, agent=lambda env: Asking(env, {9: event}, rate=10.0)) as session:
        session.let_agent(True)
        agent = session.agent
        assert isinstance(agent, Asking)
        for _ in range(9):
            assert session.verdict == "running"
            session.step()
        assert (session.verdict, session.seed, session.agent is not None) == (verdict, seed, acts)
        assert (agent.decisions, len(agent.told)) == (3, 2 if event == "reset" else 1)


def test_takes_are_recorded_with_who_acted(tmp_path: Path) -> None:
    setup = replace(playable(Setup(task="PickCuboid", relative="absolute")), stepping="async")
    with Session(setup, record_into=tmp_path / "set", instructions=("lift it",)) as session:
        for event, steps in (("start", 4), ("success", 1), ("start", 3), ("discard", 1), ("start", 2)):
            session.obey(event)
            for _ in range(steps):
                session.step()
        assert session.takes is not None
        assert [str(take) for take in session.takes.ended] == ["000000: success, 4 rows", "000001: discarded, 3 rows"]
        assert session.seed == 1  # after the first take the next episode, after a discarded one the same
    episodes = list(Dataset.open(tmp_path / "set").episodes)
    assert [(one.id, one.success, one.instruction) for one in episodes] == [
        ("000000", True, "lift it"),
        ("000001", None, "lift it"),  # what was open at the end is kept
    ]
    words = episodes[0].info.feature("notes/actor").words
    assert {words[int(number) - 1] for number in episodes[0].column("notes/actor")} == {"page"}


def test_a_reset_during_a_take_keeps_it_without_a_verdict(tmp_path: Path) -> None:
    with Session(
        replace(playable(Setup(task="PickCuboid")), stepping="async"), record_into=tmp_path / "set"
    ) as session:
        session.obey("start")
        for _ in range(4):
            session.step()
        session.reset()
        assert session.takes is not None
        assert [str(take) for take in session.takes.ended] == ["000000: no verdict, 4 rows"]
        assert (session.takes.now, session.seed) == (None, 1)
    assert [one.success for one in Dataset.open(tmp_path / "set").episodes] == [None]


@pytest.fixture
def on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[Session]:
    """A session with a take under way that the disk will not keep."""

    def fail(*_: Any) -> Any:
        raise DatasetError("no room on the disk")

    setup = replace(playable(Setup(task="PickCuboid")), stepping="async")
    with Session(setup, record_into=tmp_path / "set") as session:
        session.obey("start")
        session.step()
        monkeypatch.setattr(Recorder, "finish", fail)
        yield session


def test_a_take_that_the_disk_does_not_keep_is_told_once_and_the_next_reset_goes_on(on_a_full_disk: Session) -> None:
    with pytest.raises(DatasetError, match="no room"):
        on_a_full_disk.reset()
    on_a_full_disk.reset()
    assert on_a_full_disk.verdict == "running"


def test_no_agent_begins_after_a_take_that_the_disk_does_not_keep(on_a_full_disk: Session) -> None:
    with pytest.raises(DatasetError, match="no room"):
        on_a_full_disk.let_agent(True)
    assert on_a_full_disk.verdict == "stopped"
    assert "no room" in on_a_full_disk.problem
    assert not on_a_full_disk.advance()
    on_a_full_disk.reset()
    assert on_a_full_disk.advance()


def test_an_agent_that_cannot_be_closed_does_not_keep_the_robots_from_braking() -> None:
    class Stuck(Asking):
        def close(self) -> None:
            raise DeviceFault("it cannot be closed")

    setup = replace(playable(Setup(task="Free", relative="absolute")), stepping="async")
    with Session(setup, agent=lambda env: Stuck(env, {}, rate=10.0)) as session:
        session.let_agent(True)
        for _ in range(5):
            session.step()
        with pytest.raises(DeviceFault, match="cannot be closed"):
            session.release()
        assert session.agent is None
        assert all(guide.is_braking for guide in session.guides.values())


def test_an_episode_that_ends_by_itself_ends_the_take_with_the_verdict_of_the_task(tmp_path: Path) -> None:
    setup = replace(playable(Setup(task="PickCuboid")), stepping="async")
    with Session(setup, record_into=tmp_path / "set") as session:
        session.let_agent(True)
        session.obey("start")
        while session.takes is not None and session.takes.now is not None:
            session.step()
            assert session.steps < 600
        assert not session.is_over
        assert session.seed == 1
    (episode,) = Dataset.open(tmp_path / "set").episodes
    assert episode.success
    assert (episode.outcome or {})["loop"]["steps"] > 50


def test_without_a_folder_or_a_take_the_buttons_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with session_of() as session, pytest.raises(WrongOrder, match="give a folder"):
        session.obey("start")
    with Session(replace(playable(Setup(task="Free")), stepping="async"), record_into=tmp_path / "set") as session:
        monkeypatch.setattr(session.env, "hold", lambda: pytest.fail("a wrong key stops the robots"))
        for event, match in (("success", "no open episode"), ("discard", "no take")):
            with pytest.raises(WrongOrder, match=match):
                session.obey(event)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]


def test_real_devices_are_shown_where_they_are_measured_and_stay_when_nobody_leads(tmp_path: Path) -> None:
    setup = replace(playable(Setup(task="Free", relative="absolute")), frequency=100.0)
    with Session(setup, hardware="fake", record_into=tmp_path / "set") as session:
        guide = session.guides["fr3"]
        joints = guide.joints
        joints[0] += 0.5
        guide.lead_joints_to(joints)
        session.obey("start")
        for _ in range(30):
            session.step()
        session.release()
        for _ in range(10):
            session.step()
        stopped = session.observation["joints"]
        for _ in range(20):
            session.step()
        np.testing.assert_allclose(session.observation["joints"], stopped, atol=1e-4)
        assert 0.02 < stopped[0] - guide.robot.arm.home[0] < 0.45
        assert session._mirror is not None
        np.testing.assert_allclose(session._mirror.arms["fr3"].joints, session.observation["joints"], atol=1e-9)
        session.obey("success")
        assert not session.is_over
        assert session.seed == 0
    assert [one.success for one in Dataset.open(tmp_path / "set").episodes] == [True]


def test_after_a_take_a_real_robot_led_on_the_page_stays_where_it_is(tmp_path: Path) -> None:
    setup = playable(Setup(task="Free", relative="origin"))
    with Session(setup, hardware="fake", record_into=tmp_path / "set") as session:
        joints = session.guides["fr3"].joints
        joints[0] += 0.5
        session.guides["fr3"].lead_joints_to(joints)
        for verdict in ("success", "discard"):
            session.obey("start")
            for _ in range(45):
                session.step()
            session.obey(verdict)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
            session.step()
            np.testing.assert_allclose(session.info["target"]["joints"], joints, atol=0.02)


@pytest.mark.parametrize("is_takeover", [False, True])
def test_on_real_devices_no_policy_acts_after_a_take(is_takeover: bool, tmp_path: Path) -> None:
    def agent(env: Env) -> Agent:
        policy = Asking(env, {}, rate=10.0)
        person = Operator(env, ScriptedDevice(lambda t: held(LEVEL)), has_thread=False) if is_takeover else None
        return policy if person is None else Takeover(env, policy, person)

    setup = replace(playable(Setup(task="Free", relative="absolute")), frequency=100.0)
    with Session(setup, agent=agent, hardware="fake", record_into=tmp_path / "set") as session:
        session.let_agent(True)
        session.obey("start")
        session.step()
        session.obey("success")
        assert session.verdict == "running"
        assert session.agent.actor == "person" if isinstance(session.agent, Takeover) else session.agent is None
        session.step()
