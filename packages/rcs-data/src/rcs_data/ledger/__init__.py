"""Evaluations on disk: a line per episode that ended, comparisons of agents, and pages about them."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
