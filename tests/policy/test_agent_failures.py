"""An agent whose policy fails or is lost: what the robot does, and what comes of the episode."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from vlagents import Chunk, ConnectionLost, Metadata, Observation, PolicyFailed, Server, Unauthorized
from vlagents.policies.scripted import ScriptedPolicy

import rcs
from rcs.agents import PerRobot
from rcs.devices.fakes import FakeGripper
from rcs.envs import Env
from rcs.errors import DeviceFault, InvalidSetup, RcsError
from rcs.policy import ChunkAgent, Execution, ServedPolicy, offer_of
from rcs.rollout import run_episode
from tests.policy.swing import GRIPPER, JOINTS, Swing, rollout


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


def test_the_policy_of_one_robot_of_two_holds_that_one_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    with rcs.make("Free", robot="dual_fr3", relative=True) as env:
        told = Metadata(name="still", action=offer_of(env).action, rate=30.0, horizon=16)
        still = ScriptedPolicy(lambda *_: np.zeros((16, told.size)), told)
        failing = ScriptedPolicy(lambda *_: np.zeros((16, told.size)), replace(told, name="failing"))
        both = PerRobot(env, {"left": ChunkAgent(env, still), "right": ChunkAgent(env, failing)})
        held: list[str | None] = []
        rebase = env.rebase

        def note(robot: str | None = None) -> None:
            held.append(robot)
            rebase(robot)

        monkeypatch.setattr(env, "hold", lambda: held.append("all"))
        monkeypatch.setattr(env, "rebase", note)
        observation, info = env.reset(seed=0)
        both.reset(observation, info)
        for step in range(40):
            if step == 5:
                failing._act = lambda *_: 1 / 0  # type: ignore[assignment]
            observation, *_, info = env.step(both.act(observation, info))
        assert held == ["right"]
        assert both.notes()["right/policy_is_held"]
        assert not both.notes()["left/policy_is_held"]


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
    assert isinstance(agent._executor.error, ZeroDivisionError)
    assert action["gripper"] == 0.0
    assert np.abs(stops[-1] - stops[-10]).max() < 1e-3
    assert np.abs(observation["joint_velocities"]).max() < 0.01


def test_a_chunk_of_the_wrong_size_is_an_error_and_no_motion(env: Env) -> None:
    odd = ScriptedPolicy(lambda *_: np.zeros((4, 5)), Metadata(name="odd", action=(JOINTS, GRIPPER), rate=30.0))
    agent = ChunkAgent(env, odd)
    start, _ = env.reset(seed=0)
    rows = rollout(env, agent, 10)
    assert "actions of 5 numbers; it announced 8" in str(agent._executor.error)
    np.testing.assert_allclose(rows[-1][1]["joints"], start["joints"], atol=2e-3)


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
            errors.append(type(agent._executor.error).__name__)
        agent.close()
    assert errors[:7] == ["NoneType"] * 7
    assert "DeadlineExceeded" in errors
    assert "DeadlineExceeded" in caplog.text
    assert errors[-1] == "NoneType"


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


def test_a_policy_that_begins_again_keeps_what_a_simulated_gripper_closes_on(env: Env) -> None:
    broken = ScriptedPolicy(lambda *_: 1 / 0, Metadata(name="broken", action=(JOINTS, GRIPPER), rate=30.0))
    agent = ChunkAgent(env, broken)
    observation, _ = env.reset(seed=0)
    observation, *_, info = env.step({"joints": observation["joints"], "gripper": np.zeros(1, np.float32)})
    assert observation["gripper"] > 0.5, "rounded, that would be open"
    agent.reset(observation, info)
    assert agent.act(observation, info)["gripper"] == 0.0
    agent.close()


def test_the_policy_of_one_robot_holds_while_a_device_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(robot: str | None = None) -> None:
        raise DeviceFault("left: the cable is out")

    with rcs.make("Free", robot="dual_fr3", relative=True) as env:
        told = Metadata(name="still", action=offer_of(env).action, rate=30.0, horizon=16)
        failing = ScriptedPolicy(lambda *_: np.zeros((16, told.size)), told)
        still = ScriptedPolicy(lambda *_: np.zeros((16, told.size)), replace(told, name="other"))
        both = PerRobot(env, {"left": ChunkAgent(env, still), "right": ChunkAgent(env, failing)})
        observation, info = env.reset(seed=0)
        both.reset(observation, info)
        for step in range(40):
            if step == 5:
                failing._act = lambda *_: 1 / 0  # type: ignore[assignment]
                monkeypatch.setattr(env, "rebase", lost)
            observation, *_, info = env.step(both.act(observation, info))
        assert both.notes()["right/policy_is_held"]


def test_every_retry_is_in_a_new_session(env: Env) -> None:
    class Flaky(Swing):
        left = 2

        def infer(self, observation: Observation) -> Chunk:
            if self.left:
                self.left -= 1
                raise ConnectionLost(f"gone, {self.left} left")
            return super().infer(observation)

    policy = Flaky()
    agent = ChunkAgent(env, policy, execution=Execution(retry=0.1))
    rollout(env, agent, 20)
    assert agent._executor.error is None
    assert len(policy.resets) == 3, "that of the episode, and one for each retry"
