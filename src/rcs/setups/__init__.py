"""Setups: named, ready compositions of robot, end effector, cameras and task."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
