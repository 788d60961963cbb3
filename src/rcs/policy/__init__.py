"""Policies that run elsewhere, as agents: what they are shown, and how their chunks of actions are executed."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
