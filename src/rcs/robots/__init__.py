"""Robots, end effectors and sensors as data: one folder each, with a frozen description and its MJCF model."""
