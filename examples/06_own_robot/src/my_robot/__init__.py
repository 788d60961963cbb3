"""A six-axis arm of our own. Importing it registers its ids with Gymnasium and does nothing else."""

from rcs.setups.ids import add

add("my_robot", "MyRobot", ("PickCuboid",))
