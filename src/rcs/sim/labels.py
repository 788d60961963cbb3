"""What the numbers in segmentation are called."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

BACKGROUND = "background"
"""Name of the number 0."""


class Labels:
    """Names of the instances and geoms that pictures of a model show.

    In `frames`/camera/`geoms`, 0 is the background and n the geom n - 1 of MuJoCo's model; soft bodies, skins and
    tendons are counted on after the geoms. In `frames`/camera/`segmentation`, geoms are joined to instances: an arm
    (`fr3`), its end effector (`fr3/gripper`), an object (`cuboid`), a camera's housing (`side`), the table, a wall.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Name everything that a model draws."""
        self.instances: list[str] = [BACKGROUND]
        """Name of each instance, by its number."""
        self.geoms: list[str] = [BACKGROUND]
        """Name of each geom, by its number: its own or that of its body."""
        self._instance_of: list[int] = [0]
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            own, of_body = model.geom(geom).name, model.body(body).name
            self._add(own or of_body, _instance(model, body) or own)
        for kind, count in (("FLEX", model.nflex), ("SKIN", model.nskin), ("TENDON", model.ntendon)):
            for i in range(count):
                found: str | None = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind}"), i)
                name = found or f"{kind.lower()} {i}"
                body = _body_of_flex(model, i) if kind == "FLEX" else 0
                self._add(name, _instance(model, body) or name.rpartition("/")[0] or name)
        self._table = np.array(self._instance_of, np.uint16)

    def _add(self, geom: str, instance: str) -> None:
        instance = instance or "scene"
        if instance not in self.instances:
            self.instances.append(instance)
        self.geoms.append(geom)
        self._instance_of.append(self.instances.index(instance))

    def instances_of(self, geoms: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Return the instance of every pixel.

        Args:
            geoms: The geom of every pixel, of any shape.
        """
        return self._table[geoms]

    def to_json(self) -> dict[str, Any]:
        """Return `instances` and `geoms`, lists of names by number, and `instance_of_geom`."""
        return {"instances": self.instances, "geoms": self.geoms, "instance_of_geom": self._instance_of}


def _instance(model: mujoco.MjModel, body: int) -> str:
    """Return the instance that a body is of: its prefix, or its ancestor below the world; empty for the world."""
    while body:
        name = str(model.body(body).name)
        if "/" in name:
            return name.rpartition("/")[0]
        parent = int(model.body_parentid[body])
        if parent == 0:
            return name or f"body {body}"
        body = parent
    return ""


def _body_of_flex(model: mujoco.MjModel, flex: int) -> int:
    """Return a body that carries a soft body; 0 if it is fixed to the world."""
    first, count = int(model.flex_vertadr[flex]), int(model.flex_vertnum[flex])
    bodies = model.flex_vertbodyid[first : first + count]
    if (bodies < 0).all():  # corners between the nodes of a coarser mesh
        first, count = int(model.flex_nodeadr[flex]), int(model.flex_nodenum[flex])
        bodies = model.flex_nodebodyid[first : first + count]
    found = bodies[bodies > 0]
    return int(found[0]) if len(found) else 0
