"""Small scenes that the simulation tests share."""

from __future__ import annotations

import mujoco
import pytest

from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.sim import RobotPlacement, Scene, World
from rcs.sim.robot import SimRobot

CART = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" range="-10 10"/>
      <geom name="cart" type="box" size="0.1 0.1 0.1" mass="1"/>
      <site name="front" pos="0.1 0 0"/>
    </body>
    <body name="wall" pos="1.2 0 0">
      <geom name="wall" type="box" size="0.1 1 1"/>
    </body>
  </worldbody>
  <actuator>
    <position name="slide" joint="slide" kp="100" kv="20" ctrlrange="-10 10"/>
  </actuator>
</mujoco>
"""


@pytest.fixture(scope="session")
def cart() -> mujoco.MjModel:
    """A cart on a rail with a position servo, and a wall that it hits at x = 1 m."""
    return mujoco.MjModel.from_xml_string(CART)


@pytest.fixture(scope="session")
def placement() -> RobotPlacement:
    """An FR3 with the Franka Hand."""
    return RobotPlacement(name="fr3", arm=FR3, gripper=FRANKA_HAND)


@pytest.fixture(scope="session")
def lab(placement: RobotPlacement) -> mujoco.MjModel:
    """The robot in an empty scene."""
    scene = Scene.empty()
    scene.add_robot(placement)
    return scene.compile()


@pytest.fixture
def robot(lab: mujoco.MjModel, placement: RobotPlacement) -> SimRobot:
    """The robot at home in a world of one copy."""
    robot = SimRobot(World(lab, frequency=50.0), placement)
    robot.go_home()
    robot.world.core.keep_initial_state()
    robot.world.refresh()
    return robot
