"""A six-axis arm with its lab, task, agent and driver. `pyproject.toml` registers them; the import has no effects."""
