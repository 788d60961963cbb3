"""Simulation in MuJoCo: scenes, worlds of many copies, simulated devices and rendering."""

from rcs.sim.scene import CameraPlacement, RobotPlacement, Scene
from rcs.sim.world import Stepping, World

__all__ = ["CameraPlacement", "RobotPlacement", "Scene", "Stepping", "World"]
