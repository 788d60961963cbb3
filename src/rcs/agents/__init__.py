"""Agents: they map observations to actions. Scripted experts, replay, planners, and what people and policies share."""

from rcs_data.lazy import load_on_use

load_on_use(__name__, expert_for="agent_for(env)")
