"""Several agents in one environment, each with robots of its own."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from rcs.agents.agent import ACTOR, Agent, Event
from rcs.agents.guide import Guide
from rcs.agents.pace import Pace
from rcs.envs.env import Env
from rcs.envs.observer import Note
from rcs.envs.spaces import Action, Observation
from rcs.envs.step.stack import for_all
from rcs.errors import InvalidSetup


class PerRobot(Agent):
    """Has each robot act as its own agent says, such as a person on the left and a policy on the right.

    Every agent sees all and answers for all robots, at its own rate; of its answer, only the part of its robot counts.
    """

    def __init__(self, env: Env, agents: Mapping[str, Agent]) -> None:
        """Prepare.

        Args:
            env: The environment, of several robots.
            agents: The agent of each robot, by its name.

        Raises:
            InvalidSetup: A robot has no agent, or there is no robot of a name; or the rate of an agent does not divide
                that of the environment, or a person is to lead another robot.
        """
        if len(env.robots) < 2 or agents.keys() != env.robots.keys():
            raise InvalidSetup(
                f"The agents are for {', '.join(map(repr, agents)) or 'no robot'}; valid is one for each robot of "
                f"several, here {', '.join(map(repr, env.robots))}."
            )
        self._env = env
        self._paces = {name: Pace(env, agents[name]) for name in env.robots}
        self._resting: dict[str, Guide] = {}
        for name, agent in agents.items():
            agent.lead_only(name)

    @property
    def agents(self) -> dict[str, Agent]:
        """The agent of each robot, by its name."""
        return {name: pace.agent for name, pace in self._paces.items()}

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Have all agents begin an episode."""
        self._resting = {}
        for pace in self._paces.values():
            pace.reset(observation, info)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the next action, of all robots."""
        actions: Action = {}
        for name, pace in self._paces.items():
            given = self._resting.get(name, pace).act(observation, info)
            actions[name] = given.get(name, given)
        return actions

    def rest(self, robot: str, observation: Observation, info: Mapping[str, Any]) -> None:
        """Have a robot brake and stay, with what its gripper holds, and its agent act no more until the next `reset`.

        Args:
            robot: Name of the robot.
            observation: The present observation.
            info: Info of the last step.

        Raises:
            InvalidSetup: A layer has given the robot actions that only a policy can make.
        """
        guide = self._resting[robot] = Guide(self._env, self._env.robots[robot])
        guide.reset(observation)
        guide.keep_opening(info)
        guide.brake()

    def close(self) -> None:
        """Close all agents, also when one of them fails to. Closing twice is harmless."""
        for_all([pace.agent.close for pace in self._paces.values()])

    @property
    def failure(self) -> str | None:
        """Why the first agent that has given up has; None if none has."""
        return next((why for pace in self._paces.values() if (why := pace.agent.failure) is not None), None)

    @property
    def failure_message(self) -> str | None:
        """Words on what went wrong, agent by agent; None if nothing did."""
        messages = {name: pace.agent.failure_message for name, pace in self._paces.items()}
        return "; ".join(f"{name}: {words}" for name, words in messages.items() if words) or None

    @property
    def weights(self) -> str | None:
        """SHA-256 of the hashes of all agents' weights, in the order of the robots; None if one is not known."""
        every = [pace.agent.weights for pace in self._paces.values()]
        known = [one for one in every if one is not None]
        return hashlib.sha256("".join(known).encode()).hexdigest() if len(known) == len(every) else None

    @property
    def is_lost(self) -> bool:
        """Whether the connection of one of the agents was lost in this episode."""
        return any(pace.agent.is_lost for pace in self._paces.values())

    @property
    def latencies(self) -> Sequence[float]:
        """How long each answer of a policy took in this episode [s], agent by agent."""
        return [one for pace in self._paces.values() for one in pace.agent.latencies]

    @property
    def note_fields(self) -> Sequence[Note]:
        """The actor and the notes of all agents, each after the name of its robot."""
        every = [(name, note) for name, agent in self.agents.items() for note in _with_actor(agent.note_fields)]
        return [replace(note, name=f"{name}/{note.name}") for name, note in every]

    def notes(self) -> Mapping[str, Any]:
        """Return the notes of all agents that have decided, each after the name of its robot.

        An agent that does not say who acted is a policy; a robot that rests has no actor.
        """
        notes: dict[str, Any] = {}
        for name, pace in self._paces.items():
            if name not in self._resting:
                own: dict[str, Any] = {} if _has_actor(pace.agent.note_fields) else {ACTOR.name: "policy"}
                notes |= {f"{name}/{key}": value for key, value in {**own, **pace.notes()}.items()}
        return notes

    def events(self) -> Sequence[Event]:
        """Return the requests of all agents."""
        return [event for pace in self._paces.values() for event in pace.agent.events()]


def _has_actor(fields: Sequence[Note]) -> bool:
    return any(note.name == ACTOR.name for note in fields)


def _with_actor(fields: Sequence[Note]) -> Sequence[Note]:
    return fields if _has_actor(fields) else [ACTOR, *fields]
