"""A policy in an environment: what it sees, what its chunks come to, and what happens when it fails."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter
from vlagents import Chunk, ConnectionLost, Metadata, Observation, PartSpec, Policy, PolicyFailed, Server, Unauthorized
from vlagents.policies.scripted import ScriptedPolicy

import rcs
from rcs.devices.fakes import FakeGripper
from rcs.envs import Env
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.recorder import Recorder
from rcs.errors import InvalidSetup, RcsError, WrongOrder
from rcs.policy import NOTES, ChunkAgent, Execution, ServedPolicy, offer_of
from rcs.rollout import run_episode

JOINTS = PartSpec("joints", 7, "rad")
GRIPPER = PartSpec("gripper", 1, "0 closed, 1 open")


class Swing(Policy):
    """Leads the joints along a function of time from where they were first seen; keeps what it was shown and told."""

    def __init__(self, *, rate: float = 30.0, horizon: int = 16, meaning: str = "absolute", unit: str = "rad") -> None:
        joints = replace(JOINTS, meaning=meaning, unit=unit)  # type: ignore[arg-type]
        self.told = Metadata(
            name="swing", state=(replace(JOINTS, unit=unit),), action=(joints, GRIPPER), rate=rate, horizon=horizon
        )
        self.seen: list[Observation] = []
        self.resets: list[tuple[str, str, int | None]] = []
        self.start = np.zeros(7)
        self.error: Exception | None = None

    def metadata(self) -> Metadata:
        return self.told

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        self.resets.append((session, instruction, seed))
        self.first: float | None = None
        if self.error is not None:
            raise self.error

    def infer(self, observation: Observation) -> Chunk:
        if self.error is not None:
            raise self.error
        self.seen.append(observation)
        if self.first is None:
            self.first, self.start = observation.time, observation.state["joints"]
        ends = observation.time - self.first + (1 + np.arange(self.told.horizon)) / self.told.rate
        scale = 180 / np.pi if self.told.action[0].unit == "deg" else 1.0
        if self.told.action[0].meaning == "delta":
            rows = np.full((self.told.horizon, 7), scale * 0.3 / self.told.rate)
        else:
            rows = self.start + scale * 0.3 * ends[:, None]
        return Chunk(np.hstack([rows, np.ones((len(rows), 1))]), 1 / self.told.rate, observation.time)


@pytest.fixture
def env() -> Iterator[Env]:
    with rcs.make("Free", robot="fr3", relative=False) as made:
        yield made


def rollout(env: Env, agent: ChunkAgent, steps: int, seed: int = 0) -> list[tuple[Any, Any, Any]]:
    observation, info = env.reset(seed=seed)
    agent.reset(observation, info)
    rows = []
    for _ in range(steps):
        action = agent.act(observation, info)
        observation, _, _, _, info = env.step(action)
        rows.append((action, observation, agent.notes()))
    return rows


@pytest.mark.parametrize("mode", ["open_loop", "receding", "ensemble", "rtc"])
@pytest.mark.parametrize("rate", [5.0, 30.0])
def test_the_robot_follows_a_function_of_time_at_any_rate_of_the_policy(env: Env, mode: Any, rate: float) -> None:
    agent = ChunkAgent(env, Swing(rate=rate), execution=Execution(mode=mode))
    start, _ = env.reset(seed=0)
    for i, (action, _, _) in enumerate(rollout(env, agent, 30)):
        np.testing.assert_allclose(action["joints"], start["joints"] + 0.3 * (i + 1) / 30, atol=1e-5)


def test_differences_are_split_over_the_steps_of_a_faster_loop() -> None:
    with rcs.make("Free", robot="fr3", relative=True) as env:
        agent = ChunkAgent(env, Swing(rate=5.0, meaning="delta"))
        for action, _, _ in rollout(env, agent, 30):
            np.testing.assert_allclose(action["joints"], 0.01, atol=1e-9)


def test_a_policy_in_degrees_is_shown_degrees_and_gives_degrees(env: Env) -> None:
    policy = Swing(unit="deg")
    start, _ = env.reset(seed=0)
    rows = rollout(env, ChunkAgent(env, policy), 10)
    np.testing.assert_allclose(policy.seen[0].state["joints"], np.rad2deg(start["joints"]))
    np.testing.assert_allclose(rows[9][0]["joints"], start["joints"] + 0.1, atol=1e-5)


def test_the_policy_is_told_instruction_seed_and_time() -> None:
    with rcs.make("PickCuboid", robot="fr3", relative=False) as env:
        policy = Swing()
        rollout(env, ChunkAgent(env, policy, session="here"), 10, seed=7)
        assert policy.resets == [("here", env.instruction, 7)]
        assert policy.seen[0].instruction == env.instruction
        assert [seen.time for seen in policy.seen] == pytest.approx([0.0, 8 / 30], abs=0.002)


def test_late_answers_hold_first_and_then_are_for_their_moment(env: Env) -> None:
    agent = ChunkAgent(env, Swing(), execution=Execution(latency=0.2))
    start, _ = env.reset(seed=0)
    for i, (action, _, notes) in enumerate(rollout(env, agent, 30)):
        expected = start["joints"] + (0.0 if i < 6 else 0.3 * (i + 1) / 30)
        np.testing.assert_allclose(action["joints"], expected, atol=1e-4)
        assert notes["policy_is_held"] == (i < 6)
        if i >= 6:
            assert notes["policy_latency"] == 0.2


@pytest.mark.parametrize(("control", "relative"), [("joints", False), ("joints", True), ("tquat", False),
                                                   ("tquat", True), ("xyzrpy", False), ("xyzrpy", True),
                                                   ("twist", True)])  # fmt: skip
def test_holding_moves_nothing_in_any_control(control: Any, relative: bool) -> None:
    with rcs.make("Free", robot="fr3", control=control, relative=relative) as env:
        spec = offer_of(env).action
        still = {"tquat": [0, 0, 0, 0, 0, 0, 1.0], "joints": [0.0] * 7}.get(control, [0.0] * 6)
        failing = ScriptedPolicy(lambda *_: 1 / 0, Metadata(name="broken", action=spec, rate=30.0))
        rows = rollout(env, ChunkAgent(env, failing), 20)
        first, last = rows[0][1], rows[-1][1]
        np.testing.assert_allclose(last["joints"], first["joints"], atol=2e-3)
        if relative:
            assert rows[-1][0][control].tolist() == still


def test_a_robot_in_motion_stops_when_its_policy_fails_and_its_gripper_keeps_its_grip(env: Env) -> None:
    policy = Swing()
    policy.told = replace(policy.told, rate=30.0)
    closed = ScriptedPolicy(
        lambda seen, _: np.tile([*(seen.state["joints"] + 0.5), 0.0], (16, 1)), replace(policy.told, name="closing")
    )
    agent = ChunkAgent(env, closed)
    observation, info = env.reset(seed=0)
    agent.reset(observation, info)
    for _ in range(12):
        observation, *_, info = env.step(agent.act(observation, info))
    assert np.abs(observation["joint_velocities"]).max() > 0.3
    closed._act = lambda *_: 1 / 0  # type: ignore[assignment]
    stops = []
    for _ in range(30):
        action = agent.act(observation, info)
        observation, *_, info = env.step(action)
        stops.append(observation["joints"])
    assert isinstance(agent.error, ZeroDivisionError)
    assert action["gripper"] == 0.0
    assert np.abs(stops[-1] - stops[-10]).max() < 1e-3
    assert np.abs(observation["joint_velocities"]).max() < 0.01


def test_what_a_policy_wants_beyond_the_bounds_is_cut_and_noted(env: Env) -> None:
    far = ScriptedPolicy(lambda *_: np.full((4, 8), 50.0), Metadata(name="far", action=(JOINTS, GRIPPER), rate=30.0))
    rows = rollout(env, ChunkAgent(env, far), 3)
    box: Any = env.action_space["joints"]  # type: ignore[index]
    np.testing.assert_allclose(rows[0][0]["joints"], box.high)
    assert rows[0][2]["policy_is_clipped"] == 1.0


def test_a_chunk_of_the_wrong_size_is_an_error_and_no_motion(env: Env) -> None:
    odd = ScriptedPolicy(lambda *_: np.zeros((4, 5)), Metadata(name="odd", action=(JOINTS, GRIPPER), rate=30.0))
    agent = ChunkAgent(env, odd)
    start, _ = env.reset(seed=0)
    rows = rollout(env, agent, 10)
    assert "actions of 5 numbers; it announced 8" in str(agent.error)
    np.testing.assert_allclose(rows[-1][1]["joints"], start["joints"], atol=2e-3)


def test_a_policy_that_does_not_fit_is_refused_with_all_differences(env: Env) -> None:
    policy = Swing()
    policy.told = Metadata(
        name="other arm",
        state=(PartSpec("joints", 6, "rad"), PartSpec("tcp_wrench", 6)),
        action=(PartSpec("joints", 7, "ticks", "delta"),),
        rate=30.0,
    )
    with pytest.raises(InvalidSetup) as caught:
        ChunkAgent(env, policy)
    told = str(caught.value)
    for part in ("'other arm'", "size 6", "'tcp_wrench'", "'ticks'", "meaning 'delta'", "takes 'gripper'"):
        assert part in told, part


def test_the_same_seed_gives_the_same_bytes_with_latency_too(env: Env) -> None:
    digests = []
    for _ in range(2):
        agent = ChunkAgent(env, Swing(rate=20.0), execution=Execution(mode="rtc", latency=0.1))
        digest = hashlib.sha256()
        for action, observation, notes in rollout(env, agent, 40, seed=3):
            for value in (*action.values(), observation["joints"], np.array(list(notes.values()))):
                digest.update(value.tobytes())
        digests.append(digest.hexdigest())
    assert digests[0] == digests[1]


def test_latency_age_and_place_in_the_chunk_are_recorded(env: Env, tmp_path: Path) -> None:
    agent = ChunkAgent(env, Swing(), execution=Execution(latency=0.1))
    with DatasetWriter.open(tmp_path, dataset_info(env, notes=NOTES)) as writer:
        recorder = Recorder(writer)
        env.add_observer(recorder)
        recorder.name_next("one")
        run_episode(env, agent, seed=0, max_steps=25)
        recorder.finish(None)
    episode = Dataset.open(tmp_path).episodes[0]
    rows = {key: episode.column(f"notes/{key}") for key in NOTES}
    held = rows["policy_is_held"]
    age, row = rows["policy_age"], rows["policy_row"]
    assert held[1:4].tolist() == [1.0] * 3
    assert not held[4:].any()
    assert rows["policy_latency"][4:] == pytest.approx(0.1)
    assert row[4:] == pytest.approx(np.floor(age[4:] * 30 + 0.1))
    assert rows["policy_chunk"][-1] == 2.0


def test_a_server_that_falls_silent_means_hold_until_it_speaks_again(
    env: Env, caplog: pytest.LogCaptureFixture
) -> None:
    class Silent(Swing):
        speaks = threading.Event()

        def infer(self, observation: Observation) -> Chunk:
            assert self.speaks.wait(30.0)
            return super().infer(observation)

    policy = Silent()
    with Server(policy, port=0) as server:
        agent = ServedPolicy(address=str(server.address), timeout=1.5, execution=Execution(retry=0.3))(env)
        observation, info = env.reset(seed=0)
        agent.reset(observation, info)
        errors = []
        for step in range(40):
            (policy.speaks.clear if 6 <= step < 14 else policy.speaks.set)()
            observation, *_, info = env.step(agent.act(observation, info))
            errors.append(type(agent.error).__name__)
        agent.close()
    assert errors[:7] == ["NoneType"] * 7
    assert "DeadlineExceeded" in errors
    assert "DeadlineExceeded" in caplog.text
    assert errors[-1] == "NoneType"


def test_both_arms_are_led_by_one_policy() -> None:
    sides = ("left", "right")
    state = tuple(PartSpec(f"{side}/joints", 7, "rad") for side in sides)
    action = tuple(part for side in sides for part in (PartSpec(f"{side}/joints", 7, "rad"), replace(
        GRIPPER, name=f"{side}/gripper")))  # fmt: skip

    def act(seen: Observation, _: str) -> np.ndarray:
        left, right = (seen.state[f"{side}/joints"] for side in sides)
        return np.tile([*(left + 0.05), 1.0, *(right - 0.05), 0.0], (8, 1))

    with rcs.make("LiftBar", robot="dual_fr3", relative=False) as env:
        policy = ScriptedPolicy(act, Metadata(name="both", state=state, action=action, rate=30.0, horizon=8))
        agent = ChunkAgent(env, policy)
        start, _ = env.reset(seed=0)
        rows = rollout(env, agent, 6)
        last = rows[-1][1]
        assert (last["left"]["joints"] - start["left"]["joints"] > 0.02).all()
        assert (last["right"]["joints"] - start["right"]["joints"] < -0.02).all()
        assert (rows[-1][0]["left"]["gripper"], rows[-1][0]["right"]["gripper"]) == (1.0, 0.0)


class FailsLater(Swing):
    """Swing that can be reached when an episode begins, and never answers."""

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        self.resets.append((session, instruction, seed))


def test_an_episode_ends_when_its_policy_is_lost_and_is_not_waited_for(env: Env) -> None:
    policy = FailsLater()
    policy.error = ConnectionLost("gone")
    result = run_episode(env, ChunkAgent(env, policy, execution=Execution(on_loss="end")), seed=0, max_steps=50)
    assert result.steps == 1
    assert result.message == "ConnectionLost: gone"
    assert policy.seen == []


@pytest.mark.parametrize("error", [ConnectionLost("Nobody is there."), Unauthorized("Another token."), OSError("gone")])
def test_an_episode_without_a_policy_is_not_begun(env: Env, error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.policy.agent.WAIT", 0.3)
    policy = Swing()
    agent = ChunkAgent(env, policy)
    assert run_episode(env, agent, seed=0, max_steps=3).message is None
    policy.error = error
    with pytest.raises(RcsError, match=f"{type(error).__name__}: .*not begun"):
        run_episode(env, agent, seed=1, max_steps=3)
    assert len(policy.resets) > 2  # it was waited for
    policy.error = None
    assert run_episode(env, agent, seed=1, max_steps=3).steps == 3


def test_a_policy_that_fails_as_an_episode_begins_fails_in_that_episode(env: Env) -> None:
    policy = Swing()
    agent = ChunkAgent(env, policy)
    policy.error = PolicyFailed("ValueError: no such instruction")
    result = run_episode(env, agent, seed=0, max_steps=3)
    assert result.steps == 3
    assert result.message == "PolicyFailed: ValueError: no such instruction"
    assert agent.failure == "policy"
    policy.error = None
    assert run_episode(env, agent, seed=1, max_steps=3).message is None
    assert agent.failure is None


def test_another_policy_at_the_address_ends_what_goes_on(env: Env) -> None:
    policy = Swing()
    agent = ChunkAgent(env, policy)
    run_episode(env, agent, seed=0, max_steps=3)
    policy.told = replace(policy.told, name="another")
    with pytest.raises(InvalidSetup, match="Another policy is at the address"):
        run_episode(env, agent, seed=1, max_steps=3)


def test_in_real_time_the_loop_goes_on_while_the_policy_computes() -> None:
    class Slow(Swing):
        goes_on = threading.Event()

        def infer(self, observation: Observation) -> Chunk:
            assert self.goes_on.wait(30.0)
            return super().infer(observation)

    with rcs.make("Free", robot="fr3", relative=False, stepping="realtime", max_episode_steps=None) as env:
        policy = Slow(horizon=300)
        agent = ChunkAgent(env, policy, execution=Execution(mode="rtc"))
        observation, info = env.reset(seed=0)
        agent.reset(observation, info)
        for _ in range(10):  # steps that end, although nobody answers
            observation, *_, info = env.step(agent.act(observation, info))
            assert agent.notes()["policy_is_held"]
        policy.goes_on.set()
        for _ in range(200):
            observation, *_, info = env.step(agent.act(observation, info))
            if not agent.notes()["policy_is_held"]:
                break
        assert agent.notes()["policy_latency"] > 9 / 30
        agent.close()


def test_in_real_time_an_episode_begins_when_the_last_ones_call_has_ended() -> None:
    class OneAtATime(Swing):
        begun, goes_on = threading.Event(), threading.Event()
        is_busy = False

        def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
            assert not self.is_busy, "another call is under way"
            super().reset(session, instruction, seed=seed)

        def infer(self, observation: Observation) -> Chunk:
            self.is_busy = True
            self.begun.set()
            assert self.goes_on.wait(30.0)
            self.is_busy = False
            return super().infer(observation)

    with rcs.make("Free", robot="fr3", relative=False, stepping="realtime", max_episode_steps=None) as env:
        policy = OneAtATime()
        agent = ChunkAgent(env, policy)
        observation, info = env.reset(seed=0)
        agent.reset(observation, info)
        agent.act(observation, info)
        assert policy.begun.wait(10.0)
        threading.Timer(0.3, policy.goes_on.set).start()
        agent.reset(observation, info)
        assert agent.failure is None, agent.failure_message
        assert len(policy.resets) == 2
        waiting = agent._question(observation, info)
        agent.reset(observation, info)
        with pytest.raises(WrongOrder, match="is over"):
            waiting()
        assert len(policy.seen) == 1, "a question of the last episode is not asked in this one"
        agent.close()


def test_before_the_first_answer_a_real_gripper_drops_nothing() -> None:
    broken = ScriptedPolicy(lambda *_: 1 / 0, Metadata(name="broken", action=(JOINTS, GRIPPER), rate=30.0))

    def with_gripper(gripper: FakeGripper) -> Env:
        return rcs.make("Free", robot="fr3", relative=False, hardware={"fr3": "fake", "fr3/gripper": gripper})

    def openings(env: Env) -> list[float]:
        agent = ChunkAgent(env, broken)
        found = [float(observation["gripper"][0]) for _, observation, _ in rollout(env, agent, 5)]
        agent.close()
        return found

    with with_gripper(FakeGripper()) as env:
        assert openings(env) == [1.0] * 5, "an open one stays open"
    gripper = FakeGripper()
    gripper.body.values = gripper.body.target = np.array([0.6])
    with with_gripper(gripper) as env:
        assert max(openings(env)) <= 0.6, "rounded, that would be open"
        gripper.body.values = gripper.body.target = np.array([1.0])  # around something as wide as that
        assert openings(env)[-1] < 0.9, "the last command was to close"
