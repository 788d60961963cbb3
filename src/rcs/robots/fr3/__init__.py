"""The Franka Research 3 arm."""
