"""Setups: named, ready compositions of robot, end effector, cameras and task."""
