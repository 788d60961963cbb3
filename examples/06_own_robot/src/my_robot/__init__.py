"""A six-axis arm of our own. Importing it does nothing: `pyproject.toml` says what there is to find."""
