"""Ports turn devices, simulated or real, into commands and observations."""
