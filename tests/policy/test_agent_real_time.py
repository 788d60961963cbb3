"""An agent in real time, while its policy computes in another thread."""

from __future__ import annotations

import threading

import pytest
from vlagents import Chunk, Observation

import rcs
from rcs.errors import RcsError, WrongOrder
from rcs.policy import ChunkAgent, Execution
from tests.policy.swing import Swing


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


def test_in_real_time_an_episode_is_not_begun_while_the_last_ones_call_never_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Stuck(Swing):
        begun, goes_on = threading.Event(), threading.Event()

        def infer(self, observation: Observation) -> Chunk:
            self.begun.set()
            self.goes_on.wait(5.0)
            return super().infer(observation)

    monkeypatch.setattr("rcs.policy.agent.STUCK", 0.2)
    with rcs.make("Free", robot="fr3", relative=False, stepping="realtime", max_episode_steps=None) as env:
        policy = Stuck()
        agent = ChunkAgent(env, policy)
        observation, info = env.reset(seed=0)
        agent.reset(observation, info)
        agent.act(observation, info)
        assert policy.begun.wait(10.0)
        with pytest.raises(RcsError, match=r"'swing' has not returned .* for 0\.2 s, .*not begun.*vlagents serve"):
            agent.reset(observation, info)
        assert len(policy.resets) == 1
        policy.goes_on.set()
        monkeypatch.undo()
        agent.reset(observation, info)
        assert len(policy.resets) == 2, "once the call has returned, episodes begin again"
        agent.close()
