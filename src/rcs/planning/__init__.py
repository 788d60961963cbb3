"""Paths of joints past obstacles, and the times at which to be where on them."""

from rcs_data.lazy import load_on_use

load_on_use(__name__, plan="Planner(...).plan(...)")
