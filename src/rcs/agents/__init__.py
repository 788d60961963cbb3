"""Agents: they map observations to actions. Scripted experts, replay, and later planners, people and policies."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
