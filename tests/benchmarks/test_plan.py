from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

TWO_LINKS = """
<mujoco><worldbody>
  <geom name="obstacle 0" type="sphere" size="0.1" pos="0 0 {height}"/>
  <body name="base">
    <body name="one"><joint type="slide"/><geom type="sphere" size="0.1"/></body>
    <body name="two"><joint type="slide"/><geom type="sphere" size="0.1" pos="0.05 0 0"/></body>
  </body>
</worldbody></mujoco>
"""


@pytest.mark.parametrize(("height", "touches"), [(0.1, True), (5.0, False)])
def test_of_contacts_at_home_only_those_of_the_robot_with_itself_do_not_count(
    height: float, touches: bool, program: Any
) -> None:
    home = np.zeros(2)
    judge = program("plan").Judge(mujoco.MjModel.from_xml_string(TWO_LINKS.format(height=height)), [0, 1], home)
    assert judge.always  # the links
    assert judge.touches(home) == touches
