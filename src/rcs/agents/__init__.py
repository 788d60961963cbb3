"""Agents: they map observations to actions. Scripted experts, replay, and later planners, people and policies."""

from rcs.agents.agent import Agent
from rcs.agents.lift_expert import LiftExpert
from rcs.agents.pick_expert import PickExpert
from rcs.agents.replay import Replay
from rcs.agents.toy_expert import ToyExpert

__all__ = ["Agent", "LiftExpert", "PickExpert", "Replay", "ToyExpert"]
