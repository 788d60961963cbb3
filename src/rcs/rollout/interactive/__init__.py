"""Interactive simulation in the browser."""
