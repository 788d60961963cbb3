"""A person takes a robot over from a policy, and gives it back, without a jump of the target."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.agents import Agent, PickExpert
from rcs.errors import RcsError
from rcs.spatial import distance
from rcs.teleop import HandReading, Operator, Takeover
from tests.teleop.scripted_device import ScriptedDevice, at, held

LOOP, PERSON, POLICY = 90.0, 72.0, 10.0
TCP = {"person": np.array([0.21, 1.5]), "policy": np.array([0.45, 2.0])}
"""Largest speeds of the TCP's target: those of `LeadOptions` and of the expert [m/s, rad/s]."""


class Slow(PickExpert):
    """The expert as a policy of 10 Hz."""

    rate = POLICY


def run(env: rcs.envs.Env, agent: Agent, seconds: float) -> tuple[list[str], list[Any]]:
    observation, info = env.reset(seed=3)
    agent.reset(observation, info)
    actors, infos = [], [{**info, "measured": observation}]
    for _ in range(round(seconds * LOOP)):
        action = agent.act(observation, info)
        notes = agent.notes()
        env.note(**notes)
        actors.append(notes["actor"])
        observation, _, terminated, truncated, info = env.step(action)
        infos.append({**info, "measured": observation})
        if terminated or truncated:
            break
    return actors, infos


@pytest.mark.parametrize("control", ["joints", "tquat"])
@pytest.mark.parametrize("seed", range(10))
def test_taking_over_and_giving_back_at_random_steps_makes_no_jump(tmp_path: Path, control: Any, seed: int) -> None:
    random = np.random.default_rng(seed)
    taken = float(random.uniform(0.2, 1.5))
    given = taken + float(random.uniform(0.6, 1.2))

    def script(t: float) -> HandReading:
        buttons: list[Any] = [] if not any(0 <= t - when < 0.05 for when in (taken, given)) else ["takeover"]
        buttons += ["clutch"] if taken + 0.2 < t < given else []
        return held(at(0.05 * np.sin(3.0 * t), 0.05 * np.cos(3.0 * t), 1.0), *buttons)

    env = rcs.make("PickCuboid", control=control, relative="absolute", frequency=LOOP, max_episode_steps=None)
    with env:
        world = env.simulation.world
        device = ScriptedDevice(script, clock=lambda: float(world.time), rate=PERSON)
        operator = Operator(env, device, clock=lambda: float(world.time), has_thread=False)
        agent = Takeover(env, Slow(env), operator)
        with rcs.record(env, tmp_path / "set", notes=agent.note_fields) as takes:
            takes.start(at_reset=True)
            actors, infos = run(env, agent, given + 1.0)
            takes.finish(None)
        agent.close()
    switches = [i for i in range(1, len(actors)) if actors[i] != actors[i - 1]]
    assert [actors[i] for i in switches] == ["person", "policy"]
    fastest = np.array(env.robots["fr3"].arm.velocity_limit)
    targets = np.array([info["target"][control] for info in infos[1:]])
    measured = np.array([info["measured"][control] for info in infos])
    if control == "joints":
        steps, back, bound = np.abs(np.diff(targets, axis=0)), np.abs(targets[:-1] - measured[1:-1]), fastest / LOOP
    else:
        steps, back = distance(targets[:-1], targets[1:]), distance(targets[:-1], measured[1:-1])
        bound = np.array([TCP[actor] for actor in actors[1:]]) / LOOP
    # What brings a target back to where the arm is measured is no jump: the arm brakes at once.
    assert (steps <= back + bound + 1e-9).all()
    speeds = np.abs(np.diff([info["measured"]["joints"] for info in infos], axis=0)).max(axis=0) * LOOP
    assert (speeds < fastest).all()
    (episode,) = Dataset.open(tmp_path / "set").episodes
    words = episode.info.feature("notes/actor").words
    assert [words[int(i) - 1] for i in episode.column("notes/actor")[1:]] == actors
    assert (episode.column("notes/actor")[0]) == 0


def twice(t: float) -> HandReading:
    """A hand that takes the robot over, and gives it back."""
    return held(at(0.0, 0.0, 1.0), *(("takeover",) if 0.5 < t < 0.55 or 1.0 < t < 1.05 else ()))


@contextmanager
def interrupted(policy: Callable[[rcs.envs.Env], Agent]) -> Iterator[tuple[rcs.envs.Env, Takeover]]:
    """A policy that a person takes the robot from, and gives it back to."""
    with rcs.make("PickCuboid", relative="absolute", frequency=30.0, max_episode_steps=None) as env:
        world = env.simulation.world
        device = ScriptedDevice(twice, clock=lambda: float(world.time))
        agent = Takeover(env, policy(env), Operator(env, device, clock=lambda: float(world.time), has_thread=False))
        yield env, agent
        agent.close()


def test_the_policy_finishes_what_a_person_has_interrupted() -> None:
    with interrupted(Slow) as (env, agent):
        assert rcs.run_episode(env, agent, seed=3, max_steps=600).success


def test_a_policy_that_gets_the_robot_back_is_told_again_what_to_do() -> None:
    told: list[str] = []

    class Told(Slow):
        def reset(self, observation: Any, info: Any) -> None:
            told.append(info["instruction"])
            super().reset(observation, info)

    with interrupted(Told) as (env, agent):
        observation, info = env.reset(seed=3)
        agent.reset(observation, info)
        for _ in range(45):
            observation, *_, info = env.step(agent.act(observation, info))
        assert told == [env.instruction] * 2
        assert env.instruction


def test_a_policy_that_cannot_begin_again_leaves_the_robot_to_the_person() -> None:
    class Gone(Slow):
        is_gone = False

        def reset(self, observation: Any, info: Any) -> None:
            if self.is_gone:
                raise RcsError("Nobody answers.")
            super().reset(observation, info)

        def events(self) -> Any:
            return ("stop",) if self.is_gone else ()

    with interrupted(Gone) as (env, agent):
        observation, info = env.reset(seed=3)
        agent.reset(observation, info)
        assert agent.failure_message is None
        agent._pace.agent.is_gone = True  # type: ignore[attr-defined]  # pyright: ignore[reportAttributeAccessIssue]
        for _ in range(45):
            observation, *_, info = env.step(agent.act(observation, info))
        assert agent.actor == "person"
        assert agent.failure_message == "RcsError: Nobody answers. The person has the robots."
        assert "stop" not in agent.events()
        agent.reset(observation, info)
        assert agent.actor == "person"


def test_what_went_wrong_with_a_policy_is_said_with_a_way_on() -> None:
    class Served(Slow):
        failure_message = "The server is gone."

    with interrupted(Served) as (_, agent):
        assert agent.failure_message == "The server is gone. The person may take over."
