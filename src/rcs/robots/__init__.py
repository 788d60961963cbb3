"""Robots, end effectors and sensors as data: one folder each, with a frozen description and its MJCF model."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
