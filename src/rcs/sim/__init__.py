"""Simulation in MuJoCo: scenes, worlds of many copies, simulated devices and rendering."""

from rcs.sim.scene import CameraPlacement, RobotPlacement, Scene
from rcs.sim.world import Mode, World

__all__ = ["CameraPlacement", "Mode", "RobotPlacement", "Scene", "World"]
