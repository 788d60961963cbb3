"""Agents: they map observations to actions. Scripted experts, replay, and later planners, people and policies."""

from rcs.agents.agent import Agent, Event
from rcs.agents.choice import agent_for
from rcs.agents.experts import LiftExpert, PickExpert, ToyExpert
from rcs.agents.replay import Replay

__all__ = ["Agent", "Event", "LiftExpert", "PickExpert", "Replay", "ToyExpert", "agent_for"]
