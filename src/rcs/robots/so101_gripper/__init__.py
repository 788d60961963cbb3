"""The gripper of the SO101, with one fixed and one moving jaw."""
