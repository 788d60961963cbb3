"""The Franka Hand, a parallel gripper with two fingers."""
