"""A six-axis arm of our own with all that goes with it. Importing it does nothing: `pyproject.toml` says what is here."""
