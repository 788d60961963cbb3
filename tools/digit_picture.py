"""Draw `docs/digit.png`: three presses into a simulated DIGIT, by this library and, where it is there, Tacto.

python tools/digit_picture.py docs/digit.png
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from rcs_data.files.codec import encode_png

from rcs.errors import MissingDependency
from rcs.robots.description import Mount
from rcs.robots.tactile import DIGIT
from rcs.sim import Scene, World
from rcs.sim.tactile import SimTactile, TactileLook
from rcs.sim.tactile_mounts import TactilePlacement

TOUCH = TactilePlacement(name="touch", sensor=DIGIT, parent_body="world", sensor_in_parent=Mount())
ACROSS, EDGE = math.radians(50), math.radians(45)
PRESSES: dict[str, tuple[mujoco.mjtGeom, list[float], float, float, list[float]]] = {
    # Shape and size, distance of its foremost point from its middle, depth [m], roll and yaw in the sensor's frame.
    "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, [0.006, 0, 0], 0.006, 0.0012, [0.0, 0.0]),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, [0.004, 0.007, 0], 0.004, 0.0008, [ACROSS, 0.0]),
    "edge": (mujoco.mjtGeom.mjGEOM_BOX, [0.01, 0.01, 0.02], 0.01 * math.sqrt(2), 0.0012, [ACROSS, EDGE]),
}


def press(name: str, look: TactileLook) -> NDArray[np.uint8]:
    """Return the frame of one press, (240, 320, 3)."""
    shape, size, reach, depth, (roll, yaw) = PRESSES[name]
    scene = Scene.empty()
    scene.add_tactile(TOUCH)
    turn = np.empty(4)
    mujoco.mju_euler2Quat(turn, np.array([roll, 0.0, yaw]), "xyz")
    x, y, z = DIGIT.gel_center
    body = scene.spec.worldbody.add_body(name="object", pos=[x - depth + reach, y, z], quat=turn)
    body.add_geom(type=shape, size=size)
    sensor = SimTactile(World(scene.compile()), TOUCH, indentation="geometry", look=look)
    frame = sensor.read()["rgb"]
    sensor.close()
    return frame


def main() -> None:
    """Draw a row of frames per look."""
    rows = [[press(name, "rcs") for name in PRESSES]]
    try:
        rows.append([press(name, "tacto") for name in PRESSES])
    except MissingDependency as err:
        print(f"without Tacto: {err}", file=sys.stderr)
    gap = 6
    frames = [[np.pad(frame, ((0, gap), (0, gap), (0, 0)), constant_values=255) for frame in row] for row in rows]
    picture = np.concatenate([np.concatenate(row, axis=1) for row in frames], axis=0)
    Path(sys.argv[1]).write_bytes(encode_png(picture[:-gap, :-gap]))


if __name__ == "__main__":
    main()
