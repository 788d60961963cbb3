"""Simulators of other projects, each served from its own Python environment, as policies are."""
