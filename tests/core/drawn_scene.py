"""The scene that the tests of renderers and pools draw."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from rcs import _core

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
Image = np.ndarray[Any, np.dtype[np.uint8]]
Depth = np.ndarray[Any, np.dtype[np.uint16]]
MakeRenderer = Callable[..., _core.Renderer]

SCENE = """
<mujoco>
  <statistic extent="1"/>
  <visual><headlight ambient=".5 .5 .5" diffuse=".5 .5 .5" specular="0 0 0"/><quality shadowsize="2048"/></visual>
  <worldbody>
    <light pos="1 1 3" dir="-.3 -.3 -1" type="directional" diffuse=".3 .3 .3"/>
    <geom name="floor" type="plane" size="0 0 1" rgba=".5 .5 .5 1"/>
    <geom name="red" type="sphere" size=".06" pos=".2 .1 .06" rgba="1 0 0 1"/>
    <geom name="green" type="capsule" size=".05 .06" pos="-.2 .15 .11" rgba="0 1 0 1"/>
    <body name="blue" pos="0 -.15 .05">
      <freejoint/>
      <geom name="blue" type="cylinder" size=".06 .05" rgba="0 0 1 1"/>
    </body>
    <geom name="collision" type="box" size=".05 .05 .05" pos="0 .3 .05" rgba="1 1 0 1" group="3"/>
    <camera name="top" pos="0 0 1.5" fovy="45"/>
    <camera name="side" pos="1 -.4 .8" xyaxes=".37 .93 0 -.5 .2 .84" fovy="60"/>
    <camera name="sensor" pos="0 0 1.5" resolution="80 60" sensorsize="8 6" focalpixel="70 70" principalpixel="6 -4"/>
  </worldbody>
</mujoco>
"""


def build(xml: str = SCENE) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a model and a data at rest."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def state_of(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the integration state of a data."""
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return state


def draw(
    renderer: _core.Renderer, data: mujoco.MjData, camera: int = 0, height: int = 90, width: int = 120
) -> tuple[Image, Depth]:
    """Return the colours and the depth [mm] that a camera sees."""
    rgb, depth = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), np.uint16)
    renderer.update(data)
    renderer.render(camera, rgb, depth)
    return rgb, depth
