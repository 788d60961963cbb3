"""A session that a person leads with an input device, or takes over: faults, takes and who acted."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

from rcs.agents import Agent, PerRobot
from rcs.envs import Env
from rcs.envs.setup import Setup
from rcs.envs.spaces import Action, Observation
from rcs.rollout.interactive.session import Session, playable
from rcs.teleop import Button, HandReading, Keyboard, Operator, Takeover
from tests.teleop.scripted_device import LEVEL, ScriptedDevice, at, held


def test_a_device_leads_in_place_of_the_page_and_its_buttons_make_takes(tmp_path: Path) -> None:
    now = [0.0]

    def script(t: float) -> HandReading:
        pressed = [name for name, when in (("start", 0.3), ("success", 1.0)) if when < t < when + 0.1]
        return held(at(0.0, 0.02 * min(t, 1.0), 1.0), *(["clutch"] if t > 0.2 else []), *pressed)  # type: ignore[arg-type]

    def operator(env: Env) -> Operator:
        device = ScriptedDevice(script, clock=lambda: now[0])
        return Operator(env, device, clock=lambda: now[0], has_thread=False)

    setup = replace(playable(Setup(task="PickCuboid")), stepping="async")
    with Session(setup, agent=operator, record_into=tmp_path / "set") as session:
        session.let_agent(True)
        while session.takes is None or not session.takes.ended:
            now[0] += 1 / 30
            session.step()
            assert now[0] < 2.0
        assert session.seed == 1
    (episode,) = Dataset.open(tmp_path / "set").episodes
    assert episode.success
    places = episode.column("observation/tquat")
    assert places[-1][1] - places[0][1] == pytest.approx(0.01, abs=5e-3)
    words = episode.info.feature("notes/actor").words
    assert {words[int(number) - 1] for number in episode.column("notes/actor")} == {"person"}


def test_a_person_at_a_device_goes_on_after_a_fault_and_after_a_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    pressed: set[Button] = set()

    def operator(env: Env) -> Operator:
        device = ScriptedDevice(lambda t: held(LEVEL, *pressed), clock=lambda: now[0])
        return Operator(env, device, clock=lambda: now[0], has_thread=False)

    def press(session: Session, button: Button) -> None:
        for held_down in ((), (button,), (button,)):
            pressed.clear()
            pressed.update(held_down)
            now[0] += 1 / 30
            session.advance()

    now = [0.0]
    setup = replace(playable(Setup(task="Free")), stepping="async")
    with Session(setup, agent=operator) as session:
        session.let_agent(True)
        session.advance()
        press(session, "stop")
        assert session.verdict == "over"
        press(session, "reset")
        assert (session.verdict, session.seed) == ("running", 1)
        recoveries = 0

        def recover() -> None:
            nonlocal recoveries
            recoveries += 1

        with monkeypatch.context() as broken:
            broken.setattr(session.env, "recover", recover)
            broken.setattr(session.env.stack, "faults", lambda: {} if recoveries else {"fr3": "collision at joint 4"})
            press(session, "front")
            assert "collision" in session.problem
            press(session, "reset")
        assert (session.verdict, session.seed, recoveries) == ("running", 2, 1)


def test_the_button_takeover_without_a_policy_leaves_a_device_the_lead() -> None:
    now = [0.0]

    def operator(env: Env) -> Operator:
        def script(t: float) -> HandReading:
            return held(LEVEL, *(("takeover",) if 0.3 < t < 0.4 else ()))

        device = ScriptedDevice(script, clock=lambda: now[0])
        return Operator(env, device, clock=lambda: now[0], has_thread=False)

    setup = replace(playable(Setup(task="Free")), stepping="async")
    with Session(setup, agent=operator) as session:
        session.let_agent(True)
        for _ in range(20):
            now[0] += 1 / 30
            session.step()
        assert isinstance(session.agent, Operator)


class Typed:
    """Keys of a page, none of which is held."""

    damaged = 0

    def __init__(self) -> None:
        self.held: set[str] = set()
        self.pressed: list[str] = []

    @property
    def time(self) -> float:
        return time.monotonic()

    def open(self) -> None: ...

    def wait(self, seconds: float) -> None:
        time.sleep(seconds)

    def close(self) -> None: ...


def test_a_take_led_by_keys_after_another_one_has_all_notes_of_them(tmp_path: Path) -> None:
    setup = replace(playable(Setup(task="Free")), stepping="async")
    with Session(setup, record_into=tmp_path / "set") as session:
        for keys in (None, Keyboard(keys=Typed())):
            session.obey("start")
            if keys is not None:
                session.let_keys(keys, "fr3")
            end = time.monotonic() + 20
            session.step()
            while session.operator is not None and session.operator.news.reading is None:
                assert time.monotonic() < end
                session.step()
            session.obey("success")
    first, second = Dataset.open(tmp_path / "set").episodes
    assert np.isnan(first.column("notes/input_time")).all()
    assert np.isfinite(second.column("notes/input_time")[-1])
    assert second.info.feature("notes/right_state").words[int(second.column("notes/right_state")[-1]) - 1] == "released"
    words = second.info.feature("notes/actor").words
    assert {words[int(one) - 1] for take in (first, second) for one in take.column("notes/actor")} == {"page"}


class Turning(Agent):
    """A policy that turns the first joint of a robot on and on."""

    def __init__(self, robot: str = "") -> None:
        self.robot = robot

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        joints = (observation[self.robot] if self.robot else observation)["joints"]
        return {"joints": joints + np.array([0.02, *[0.0] * 6]), "gripper": np.ones(1, np.float32)}


def test_when_the_page_that_led_is_gone_a_policy_gives_the_robots_to_the_person_who_may_take_over() -> None:
    def takeover(env: Env) -> Takeover:
        device = ScriptedDevice(lambda t: held(LEVEL), clock=lambda: float(env.simulation.world.time))
        operator = Operator(env, device, clock=lambda: float(env.simulation.world.time), has_thread=False)
        return Takeover(env, Turning(), operator)

    setup = replace(playable(Setup(task="Free", relative="absolute")), stepping="async")
    with Session(setup, agent=takeover) as session:
        session.let_agent(True)
        for _ in range(10):
            session.step()
        assert isinstance(session.agent, Takeover)
        assert session.agent.actor == "policy"
        session.release()
        assert isinstance(session.agent, Takeover), "the person at the device may lead"
        assert session.agent.actor == "person"
        for _ in range(40):
            session.step()
        stopped = session.observation["joints"]
        for _ in range(20):
            session.step()
        np.testing.assert_allclose(session.observation["joints"], stopped, atol=1e-4)


def test_when_the_page_that_led_is_gone_a_policy_beside_a_person_rests() -> None:
    def both(env: Env) -> PerRobot:
        device = ScriptedDevice(lambda t: held(LEVEL), clock=lambda: float(env.simulation.world.time))
        clock = device.clock
        person = Operator(env, device, robots={"right": "left"}, clock=clock, has_thread=False)
        return PerRobot(env, {"left": person, "right": Turning("right")})

    setup = replace(playable(Setup(task="Free", robot="dual_fr3", relative="absolute")), stepping="async")
    with Session(setup, agent=both) as session:
        session.let_agent(True)
        start = session.observation["right"]["joints"]
        for _ in range(10):
            session.step()
        session.release()
        assert isinstance(session.agent, PerRobot), "the person at the device may lead"
        for _ in range(40):
            session.step()
        stopped = session.observation["right"]["joints"]
        assert np.abs(stopped - start).max() > 0.02
        for _ in range(20):
            session.step()
        np.testing.assert_allclose(session.observation["right"]["joints"], stopped, atol=1e-4)
