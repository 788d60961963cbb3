"""The UFACTORY xArm 7 arm."""
