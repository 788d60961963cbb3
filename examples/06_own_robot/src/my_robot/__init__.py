"""A six-axis arm of our own and what goes with it. Importing it does nothing: `pyproject.toml` says what is here."""
