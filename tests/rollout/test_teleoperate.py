"""One loop over many takes: every event acts, takes are recorded as a person judges them, figures are kept."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, EpisodeRecord

import rcs
from rcs.agents import Agent, Event, PerRobot
from rcs.envs.spaces import Action, Observation
from rcs.rollout.latency import Latency
from rcs.rollout.takes import Takes
from rcs.rollout.teleoperate import Teleoperation
from rcs.teleop import Operator, Takeover
from tests.rollout.asking import Asking
from tests.teleop.scripted_device import LEVEL, ScriptedDevice, at, held

Make = Callable[..., tuple[Teleoperation, list[str]]]


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Make]:
    with ExitStack() as stack:

        def made(requests: Mapping[int, Event], *, task: str = "PickCuboid", **options: Any) -> Any:
            names = ("hardware", "stepping", "max_episode_steps")
            setup: dict[str, Any] = {name: options.pop(name) for name in names if name in options}
            env = stack.enter_context(rcs.make(task, **{"max_episode_steps": None, **setup}))
            agent, told = Asking(env, requests), list[str]()
            recorder = stack.enter_context(rcs.record(env, tmp_path / "set", notes=agent.note_fields))
            takes = Takes(recorder, env.frequency, instructions=options.pop("instructions", ()))
            return Teleoperation(env, agent, takes=takes, report=told.append, **options), told

        yield made


def kept(tmp_path: Path) -> list[EpisodeRecord]:
    return list(Dataset.open(tmp_path / "set").episodes)


def test_takes_are_begun_judged_and_discarded_by_events(make: Make, tmp_path: Path) -> None:
    loop, told = make(
        {3: "start", 10: "success", 12: "start", 20: "discard", 22: "start", 30: "failure", 32: "start", 40: "start",
         44: "stop"},
        seed=7, instructions=("put it there", "now here"),
    )  # fmt: skip
    loop.run()
    episodes = kept(tmp_path)
    assert [(one.id, one.success, one.instruction) for one in episodes] == [
        ("000000", True, "put it there"),
        ("000001", False, "now here"),
        ("000002", False, "put it there"),  # the verdict of the task
    ]
    assert [one.length for one in episodes] == [7, 8, 8]
    assert loop.takes is not None
    assert [take.is_kept for take in loop.takes.ended] == [True, False, True, True]
    assert [(one.outcome or {})["loop"]["steps"] for one in episodes] == [7, 8, 8]
    # A discarded take is followed by the same episode again, one that is kept by the next.
    assert loop.seed == 7 + 3
    assert len(loop.agent.told) == 1 + 4  # type: ignore[attr-defined]  # pyright: ignore[reportAttributeAccessIssue]
    assert "Take 000000: success" in told[1]


@pytest.mark.parametrize("is_real", [False, True])
def test_a_policy_is_told_the_instruction_of_the_next_take(make: Make, is_real: bool) -> None:
    setup: dict[str, Any] = {"task": "Free", "hardware": "fake"} if is_real else {}
    loop, _ = make(
        {3: "start", 6: "success", 9: "start", 12: "discard", 15: "stop"}, instructions=("put it there", "now here"),
        **setup,
    )  # fmt: skip
    loop.run()
    told = loop.agent.told  # type: ignore[attr-defined]  # pyright: ignore[reportAttributeAccessIssue]
    assert told == ["put it there", "now here", "now here"]


def test_words_and_vectors_beside_the_steps_are_recorded_and_when_targets_were_sent(make: Make, tmp_path: Path) -> None:
    loop, _ = make({2: "start", 8: "success", 9: "stop"})
    loop.run()
    (episode,) = kept(tmp_path)
    feature = episode.info.feature("notes/mood")
    assert feature.words == ("calm", "angry")
    np.testing.assert_array_equal(episode.column("notes/mood"), [1] * episode.length)
    np.testing.assert_array_equal(episode.column("notes/place"), np.tile(np.arange(3.0), (episode.length, 1)))
    sent, seen = episode.column("time/command"), episode.column("time/monotonic")
    assert np.isnan(sent[0]) or sent[0] < seen[0]
    assert (sent[1:] < seen[1:]).all()
    assert (sent[1:] > seen[:-1]).all()


def test_an_event_that_makes_no_sense_is_told_and_changes_nothing(make: Make, tmp_path: Path) -> None:
    loop, told = make({2: "success", 3: "discard", 6: "takeover", 8: "stop"})
    loop.run()
    assert told == ["There is no take; start one first."] * 2
    assert kept(tmp_path) == []
    assert loop.takes is not None
    assert loop.takes.ended == []


def test_a_policy_that_is_lost_is_told_once(make: Make) -> None:
    class Lost(Asking):
        @property
        def failure_message(self) -> str | None:
            return "The server is gone." if 3 <= self.decisions < 6 or self.decisions > 8 else None

    loop, told = make({})
    loop.agent.__class__ = Lost
    _begun(loop)
    for _ in range(10):
        loop.advance()
    assert told == ["The server is gone."] * 2


def test_a_reset_begins_the_next_episode(make: Make) -> None:
    loop, _ = make({4: "reset", 8: "reset", 9: "stop"}, seed=3)
    loop.run()
    assert loop.seed == 5


def test_a_reset_during_a_take_keeps_it_without_a_verdict(make: Make, tmp_path: Path) -> None:
    loop, told = make({3: "start", 10: "reset", 14: "stop"}, seed=3)
    loop.run()
    assert [(one.id, one.success, one.length) for one in kept(tmp_path)] == [("000000", None, 7)]
    assert "Take 000000: no verdict" in told[1]
    assert loop.seed == 4


def test_ctrl_c_during_a_take_keeps_it_without_a_verdict_and_with_its_figures(make: Make, tmp_path: Path) -> None:
    loop, told = make({3: "start"})
    asked = itertools.count()

    def interrupt() -> bool:
        if next(asked) == 8:  # after so many steps
            raise KeyboardInterrupt
        return False

    with pytest.raises(KeyboardInterrupt):
        loop.run(interrupt)
    assert loop.takes is not None
    assert loop.takes.kept == 1
    assert "Take 000000: no verdict" in told[-1]
    (episode,) = kept(tmp_path)
    assert (episode.success, (episode.outcome or {})["loop"]["steps"]) == (None, 5)


def test_an_episode_of_real_devices_that_ends_during_a_take_asks_for_a_reset(make: Make) -> None:
    loop, told = make({3: "start"}, task="Free", hardware="fake", max_episode_steps=6)
    _begun(loop)
    while not loop.is_over:
        loop.advance()
    assert "Take 000000" in told[-2]
    assert told[-1] == "The episode is over. Reset to go on."


def test_a_refusal_is_told_once_whatever_its_figures_and_again_after_a_while(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, told = make({})
    step, reasons = _begun(loop).env.step, ["link5 is 3.2 mm away", "", "link5 is 2 mm away", "the hand is 1 mm away"]

    def refuse(action: Action) -> Any:
        *rest, info = step(action)
        why = reasons.pop(0)
        return (*rest, {**info, "refused": why} if why else info)

    monkeypatch.setattr(loop.env, "step", refuse)
    while reasons:
        loop.advance()
    assert told == ["Refused: link5 is 3.2 mm away", "Refused: the hand is 1 mm away"]
    monkeypatch.setattr("rcs.rollout.teleoperate.AGAIN", 0.0)
    reasons.append("the hand is 1 mm away")
    loop.advance()
    assert told[2:] == ["Refused: the hand is 1 mm away"]


def test_a_fault_keeps_the_take_open_until_a_person_decides(make: Make, tmp_path: Path) -> None:
    loop, told = make({3: "start"}, task="Free", hardware="fake")
    arm: Any = next(port.device for port in _begun(loop).env.stack.ports if port.device is not None)
    for _ in range(8):
        loop.advance()
    arm.trip("a person has pushed it")
    while not loop.is_over:
        loop.advance()
    assert "a person has pushed it" in told[-1]
    assert loop.takes is not None
    assert loop.takes.now == "000000"
    steps = loop.statistics.steps
    loop.advance()  # waits; no device is commanded
    assert loop.statistics.steps == steps
    loop.obey("failure")
    assert [(one.id, one.success) for one in kept(tmp_path)] == [("000000", False)]
    loop.obey("reset")
    assert not loop.is_over
    loop.advance()
    assert not loop.is_over


def test_a_reset_while_the_fault_stays_is_told_and_may_be_tried_again(make: Make) -> None:
    loop, told = make({}, task="Free", hardware="fake", seed=3)
    arm: Any = next(port.device for port in _begun(loop).env.stack.ports if port.device is not None)
    arm.lose_link()
    while not loop.is_over:
        loop.advance()
    for _ in range(2):
        loop.obey("reset")
        assert loop.is_over
        assert "Reset to try again" in told[-1]
        loop.advance()
    arm.restore()
    loop.obey("reset")
    assert not loop.is_over
    assert loop.seed == 1
    loop.advance()
    arm.trip("a person has pushed it")
    loop.obey("reset")  # before a step has seen it
    loop.obey("reset")
    assert not loop.is_over


def test_a_device_that_is_lost_during_a_take_leaves_it_open_until_a_person_decides(tmp_path: Path) -> None:
    device = ScriptedDevice(lambda t: held(LEVEL, "clutch"))
    with rcs.make("Free", hardware="fake", max_episode_steps=None) as env:
        person = Operator(env, device, has_thread=False)
        with rcs.record(env, tmp_path / "set", notes=person.note_fields) as recorder:
            loop = _begun(Teleoperation(env, person, takes=Takes(recorder, env.frequency)))
            loop.obey("start")
            loop.advance()
            device.fate = "silent"
            for _ in range(10):
                loop.advance()
            assert loop.takes is not None
            assert loop.takes.is_recording
            assert not loop.is_over
            assert person.states == {"right": "held"}
            loop.obey("discard")
            assert loop.takes.now is None
        person.close()


def _begun(loop: Teleoperation) -> Teleoperation:
    loop.begin(0)
    return loop


def test_on_real_devices_a_take_ends_and_the_loop_goes_on_where_the_robot_is(make: Make, tmp_path: Path) -> None:
    loop, _ = make({3: "start", 9: "success", 12: "stop"}, task="Free", hardware="fake")
    loop.run()
    assert [(one.id, one.success) for one in kept(tmp_path)] == [("000000", True)]
    assert loop.seed == 0
    assert not loop.is_over


def test_on_real_devices_the_person_leads_after_a_take_and_not_the_policy(tmp_path: Path) -> None:
    with rcs.make("Free", hardware="fake", max_episode_steps=None) as env:
        policy = Asking(env, {})
        person = Operator(env, ScriptedDevice(lambda t: held(LEVEL)), has_thread=False)
        agent = Takeover(env, policy, person)
        with rcs.record(env, tmp_path / "set", notes=person.note_fields) as recorder:
            loop = Teleoperation(env, agent, takes=Takes(recorder, env.frequency))
            loop.begin(0)
            for verdict in ("success", "discard"):
                loop.obey("start")
                loop.advance()
                assert (agent.actor, policy.decisions > 0) == ("policy", True)
                loop.obey(verdict)
                decisions = policy.decisions
                loop.advance()
                assert (agent.actor, policy.decisions) == ("person", decisions)
                loop.obey("reset")
            assert agent.actor == "policy"
        agent.close()
    (episode,) = Dataset.open(tmp_path / "set").episodes
    assert episode.info.feature("notes/actor").words == ("policy", "person")


def test_after_a_take_a_real_robot_stays_whatever_its_actions_count_from(tmp_path: Path) -> None:
    def script(t: float) -> Any:
        return held(at(0.0, 0.1 * min(t, 1.5), 1.0), *(("clutch",) if t > 0.2 else ()))

    with rcs.make("Free", hardware="fake", relative="origin", binary_gripper=False, max_episode_steps=None) as env:
        person = Operator(env, ScriptedDevice(script), has_thread=False)
        with rcs.record(env, tmp_path / "set", notes=person.note_fields) as recorder:
            loop = Teleoperation(env, person, takes=Takes(recorder, env.frequency))
            loop.begin(0)
            start = loop.observation["joints"]
            loop.obey("start")
            for _ in range(75):
                loop.advance()
            led = loop.observation["joints"]
            assert np.abs(led - start).max() > 0.1
            loop.obey("success")
            loop.advance()
            np.testing.assert_allclose(loop.info["target"]["joints"], led, atol=0.02)
        person.close()


def test_what_a_real_gripper_holds_does_not_fall_at_a_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    pressed: set[Any] = set()
    with rcs.make("Free", hardware="fake", binary_gripper=False, max_episode_steps=None) as env:
        person = Operator(env, ScriptedDevice(lambda t: held(LEVEL, *pressed)), has_thread=False)
        loop = _begun(Teleoperation(env, person))
        for button in ((), ("gripper",)):
            pressed.update(button)
            for _ in range(5):
                loop.advance()
        assert loop.info["target"]["gripper"] == [0.0]
        reset = env.reset

        def around(**options: Any) -> Any:
            observation, info = reset(**options)
            return {**observation, "gripper": np.array([0.4], np.float32)}, info  # it has met something

        monkeypatch.setattr(env, "reset", around)
        loop.obey("reset")
        loop.advance()
        assert loop.info["target"]["gripper"] == [0.0]
        person.close()


class Turning(Agent):
    """Turns the first joint of the right robot on and on."""

    steps = 0

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        self.steps += 1
        joints = observation["right"]["joints"] + np.array([0.02, *[0.0] * 6])
        return {"joints": joints, "gripper": np.ones(1, np.float32)}


def test_on_real_devices_a_policy_beside_a_person_rests_after_a_take_until_a_reset(tmp_path: Path) -> None:
    hardware = {name: "fake" for arm in ("left", "right") for name in (arm, f"{arm}/gripper")}
    setup: dict[str, Any] = {"robot": "dual_fr3", "relative": "absolute", "max_episode_steps": None}
    with rcs.make("Free", hardware=hardware, **setup) as env:
        person = Operator(env, ScriptedDevice(lambda t: held(LEVEL)), robots={"right": "left"}, has_thread=False)
        policy = Turning()
        both = PerRobot(env, {"left": person, "right": policy})
        with rcs.record(env, tmp_path / "set", notes=both.note_fields) as recorder:
            loop = Teleoperation(env, both, takes=Takes(recorder, env.frequency))
            loop.begin(0)
            loop.obey("start")
            for _ in range(10):
                loop.advance()
            loop.obey("success")
            for _ in range(40):
                loop.advance()
            stopped = loop.observation["right"]["joints"]
            for _ in range(10):
                loop.advance()
            assert policy.steps == 10
            np.testing.assert_allclose(loop.observation["right"]["joints"], stopped, atol=1e-3)
            loop.obey("reset")
            loop.advance()
            assert policy.steps == 11
        both.close()


class Moving(Asking):
    """Rests, and moves now and then."""

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        if self.steps % 30 == 20:
            joints = self.guide.joints
            joints[0] += 0.3
            self.guide.lead_joints_to(joints)
        return super().act(observation, info)


@pytest.mark.gl
def test_the_latency_goes_from_the_reading_to_the_command_and_to_the_first_picture_that_has_changed() -> None:
    with rcs.make("Free", cameras=("side",), stepping="realtime", max_episode_steps=None) as env:
        latency = Latency()
        env.add_observer(latency)
        loop = Teleoperation(env, Moving(env, {110: "stop"}))
        loop.run()
    assert len(latency.commands) > 90
    assert 0.01 <= np.median(latency.commands) < 0.03
    assert len(latency.pictures) >= 2
    assert all(time > command for time, command in zip(latency.pictures, [0.01] * 9, strict=False))
    assert max(latency.pictures) < 0.5
    assert "event to picture" in str(latency)
