"""The command `vlagents`."""
