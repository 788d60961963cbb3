"""The Universal Robots UR5e arm."""
