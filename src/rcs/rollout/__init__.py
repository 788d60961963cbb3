"""Rollouts: an agent in an environment, once or a thousand times."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
