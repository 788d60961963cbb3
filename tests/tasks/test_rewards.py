"""For every task and reward, at the discounts that are used: to finish pays more than anything that does not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, get_args

import pytest

import rcs
from rcs.agents import agent_for
from rcs.envs.reward import PROGRESS_SHARE, STILL_SHARE, RewardKind, Rewards

STEPS = 300
"""Length of an episode that nothing ends; its last state is paid without an estimate of what would follow."""
RULES: list[tuple[RewardKind, float]] = [(kind, discount) for kind in get_args(RewardKind) for discount in (0.97, 0.99)]
FOR_EVER = 1e9
"""A time to hold, or to rest, that no episode has [s]."""
TASKS = [
    ("PickCuboid", "fr3", "hold_time"),
    ("LiftBar", "dual_fr3", "hold_time"),
    ("Place", "fr3", "rest_time"),
    ("StackCuboid", "fr3", "rest_time"),
    ("Push", "fr3", "hold_time"),
    ("PickToy", "xarm7", "hold_time"),
]
Policy = Callable[[int, Any, Any], Any]
"""From the number of the step, an observation and an info to an action."""


@dataclass
class Episode:
    """The worth of an episode by every rule."""

    returns: dict[tuple[str, float], float]
    start: float
    """Potential of the first state."""
    success: bool = False
    placed: int = STEPS
    """First step after which all was in place."""

    def at_most(self, kind: str, discount: float) -> float:
        """Return what the episode could be worth if it went on for ever without a success."""
        if kind == "shaped":
            return -self.start  # the potential is bounded
        most = PROGRESS_SHARE + STILL_SHARE if kind == "dense" else 0.0
        return self.returns[kind, discount] + discount**STEPS * most / (1.0 - discount)


def play(setup: rcs.Setup, make_policy: Callable[[Any], Policy]) -> Episode:
    """Return what the same episode is worth by all rules."""
    env = rcs.make(setup)
    simulation, policy = env.simulation, make_policy(env)
    rules = {rule: Rewards(simulation.world, simulation.robots, *rule) for rule in RULES}
    observation, info = env.reset(seed=2)
    judgement = simulation.evaluate()
    for rewards in rules.values():
        rewards.begin(judgement, ...)
    episode = Episode(dict.fromkeys(RULES, 0.0), float(judgement.progress))  # type: ignore[arg-type]
    for step in range(STEPS):
        observation, _, episode.success, _, info = env.step(policy(step, observation, info))
        judgement = simulation.evaluate()
        for rule, rewards in rules.items():
            paid = float(rewards.pay(judgement, terminated=episode.success))
            episode.returns[rule] += rule[1] ** step * paid
        if judgement.is_placed:
            episode.placed = min(episode.placed, step)
        if episode.success:
            break
    env.close()
    return episode


def expert(env: Any) -> Policy:
    """Do as the task's expert does."""
    agent = agent_for(env)

    def act(step: int, observation: Any, info: Any) -> Any:
        if step == 0:
            agent.reset(observation, info)
        return agent.act(observation, info)

    return act


def until(is_time: Callable[[int, Any], bool]) -> Callable[[Any], Policy]:
    """Do as the expert does until it is time, then stay, with the gripper as it is."""

    def make(env: Any) -> Policy:
        follow = expert(env)
        stayed: list[Any] = []

        def act(step: int, observation: Any, info: Any) -> Any:
            if stayed:
                return stayed[0]
            action = follow(step, observation, info)
            if is_time(step, info):
                action = still(action)
                stayed.append(action)
            return action

        return act

    return make


def still(action: Any) -> Any:
    """Return an action that moves no arm."""
    if not isinstance(action, dict):
        return 0.0 * action
    return {key: own if key in ("gripper", "hand") else still(own) for key, own in action.items()}


def is_touched(_: int, info: Any) -> bool:
    return bool(info.get("is_touched")) or bool(info.get("is_grasped"))


@pytest.mark.parametrize(("task", "robot", "time"), TASKS)
def test_to_finish_pays_more_than_anything_that_does_not(task: str, robot: str, time: str) -> None:
    setup = rcs.Setup(task=task, robot=robot, max_episode_steps=None, collision_reaction=False)
    never_done = replace(setup, task_options={time: FOR_EVER})
    done = play(setup, expert)
    assert done.success
    others = {
        "have all in place for ever": play(never_done, expert),
        "stop just before the goal": play(setup, until(lambda step, _: step >= done.placed - 8)),
        "touch it for ever": play(setup, until(is_touched)),
        "never move": play(setup, until(lambda *_: True)),
    }
    assert others["have all in place for ever"].placed == done.placed < others["stop just before the goal"].placed
    for what, other in others.items():
        assert not other.success, what
        for kind, discount in RULES:
            own = done.returns[kind, discount]
            message = f"{kind} at {discount}: {own:.4f} for success"
            assert own > other.returns[kind, discount], f"{message}, no more than for: {what}, {STEPS} steps"
            assert own > other.at_most(kind, discount), f"{message}, no more than for: {what}, for ever"
