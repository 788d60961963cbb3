"""Gates see the targets of all robots before any device does."""
