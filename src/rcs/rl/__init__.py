"""Reinforcement learning: environments as learners want them."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
