"""Policies that run elsewhere, as agents: their observations, and the execution of their chunks of actions."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
