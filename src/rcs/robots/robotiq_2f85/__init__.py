"""The Robotiq 2F-85, a gripper with two fingers on a linkage."""
