"""A policy that a person takes the robots from, and gives them back to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from rcs.agents.agent import Agent, Event
from rcs.agents.pace import Pace
from rcs.agents.per_robot import PerRobot
from rcs.envs.env import Env
from rcs.envs.observer import Note
from rcs.envs.spaces import Action, Observation
from rcs.envs.step.stack import for_all
from rcs.errors import RcsError
from rcs.teleop.operator import Operator

Actor = Literal["policy", "person"]


class Takeover(Agent):
    """Lets a policy act until a person takes over, by the event `takeover`, and again after the next one.

    The environment steps at the person's rate and the policy decides at its own. Neither way do the robots jump: a
    person's robots brake and stay until the clutch is pressed, and the policy begins anew with what it then observes.
    The note `actor` says who acted in each row. A policy that cannot begin leaves the robots to the person.
    """

    def __init__(self, env: Env, policy: Agent, operator: Operator) -> None:
        """Prepare.

        Args:
            env: The environment.
            policy: Any agent.
            operator: The person.

        Raises:
            InvalidSetup: The policy's rate does not divide the environment's, or its repeated actions would add up.
        """
        self.actor: Actor = "policy"
        """The present actor."""
        self.operator = operator
        """The person."""
        self._pace = Pace(env, policy)
        self._events: list[Event] = []
        self._refusal: str | None = None

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin an episode with the policy."""
        self.actor = "policy"
        self.operator.reset(observation, info)
        self._begin_policy(observation, info)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the present actor's action, after the person's requests."""
        is_person = self.actor == "person"
        action = self.operator.act(observation, info) if is_person else self.operator.wait(observation, info)
        events = self.operator.events()
        self._events += events
        if events.count("takeover") % 2:
            if is_person:
                self.actor = "policy"
                if not self._begin_policy(observation, info):
                    action = self.operator.act(observation, info)
            else:
                self.give_to_person(observation, info)
                action = self.operator.act(observation, info)
        return self._pace.act(observation, info) if self.actor == "policy" else action

    def _begin_policy(self, observation: Observation, info: Mapping[str, Any]) -> bool:
        """Have the policy begin, or the person act if it cannot; return whether it does."""
        self._refusal = None
        try:
            self._pace.reset(observation, info)
        except RcsError as err:
            self._refusal = f"{type(err).__name__}: {err} The person has the robots."
            self.give_to_person(observation, info)
        return self._refusal is None

    def give_to_person(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Have the person act from where the robots are; arguments as of `Operator.take_over`."""
        self.actor = "person"
        self.operator.take_over(observation, info)

    def lead_only(self, robot: str) -> None:
        """Have both act for one robot of several; faults as in `Operator.lead_only`."""
        self.operator.lead_only(robot)
        self._pace.agent.lead_only(robot)

    @property
    def note_fields(self) -> Sequence[Note]:
        """The actor, and the notes of both."""
        return [*self._pace.agent.note_fields, *self.operator.note_fields]

    def notes(self) -> Mapping[str, Any]:
        """Return who acted, and the notes of both."""
        own = self._pace.notes() if self.actor == "policy" else {}
        return {**own, **self.operator.notes(), "actor": self.actor}

    def events(self) -> Sequence[Event]:
        """Return the person's requests since the last call, oldest first."""
        events, self._events = self._events, []
        return [*events, *(self._pace.agent.events() if self.actor == "policy" else ())]

    @property
    def failure_message(self) -> str | None:
        """Words on why the policy could not begin, or its message about a problem."""
        words = self._pace.agent.failure_message
        return self._refusal or (words and f"{words} The person may take over.")

    def close(self) -> None:
        """Close both, also when one of them fails to. Closing twice is harmless."""
        for_all([self.operator.close, self._pace.agent.close])


def people_of(agent: Agent | None) -> list[Operator]:
    """Return the people who lead robots through an agent."""
    if isinstance(agent, PerRobot):
        return [person for own in agent.agents.values() for person in people_of(own)]
    person = agent.operator if isinstance(agent, Takeover) else agent
    return [person] if isinstance(person, Operator) else []


def end_policies(agent: Agent | None, observation: Observation, info: Mapping[str, Any]) -> None:
    """Have no policy act beside people: they get the robots that they may take over, and the others rest.

    Args:
        agent: The present agent; None for none.
        observation: The present observation.
        info: Info of the last step.
    """
    if isinstance(agent, Takeover) and agent.actor == "policy":
        agent.give_to_person(observation, info)
    elif isinstance(agent, PerRobot):
        for name, own in agent.agents.items():
            if people_of(own):
                end_policies(own, observation, info)
            else:
                agent.rest(name, observation, info)
