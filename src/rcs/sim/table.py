"""How high the table of a scene stands, which may vary from episode to episode."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.sim.scene import TABLE
from rcs.sim.world import World


def table_height(world: World) -> NDArray[np.float64]:
    """Return the present height of the table top in the scene [m], (*leading,); 0 without a table."""
    table = mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_BODY, TABLE)
    return np.zeros(world.leading) if table < 0 else world.field("body_pos")[..., table, 2].copy()
