"""Simulation in MuJoCo: scenes, worlds of many copies, simulated devices and rendering."""

from rcs_data.lazy import load_on_use

load_on_use(__name__)
