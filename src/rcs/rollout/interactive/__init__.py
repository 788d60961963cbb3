"""Interactive simulation in a window or browser."""
