"""Where a tactile sensor is mounted, and how it takes the place of a finger's pad."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from rcs.errors import InvalidSetup
from rcs.kinematics.chain import load, mount_frame
from rcs.robots.description import Mount
from rcs.robots.tactile import TactileDescription

CONTACT_FIELDS = ("condim", "friction", "solref", "solimp", "margin", "gap", "priority", "solmix")
"""What a gel takes over from the pad that it replaces: how it holds, not its shape."""


@dataclass(frozen=True, kw_only=True)
class TactilePlacement:
    """One tactile sensor and where it is mounted."""

    name: str
    """Name in keys and prefixes, such as `left_touch`."""
    sensor: TactileDescription
    parent_body: str
    """Body of the scene that carries it; `world` for one that stands still."""
    sensor_in_parent: Mount
    """Pose of the sensor's frame (x out of the gel, z along its longer side) in the parent body's frame."""
    replaced_pad: str | None = None
    """Geom of the parent body that the gel takes the place of; None when nothing is in its way.

    The gel gets its name, so that whoever asks for the contacts of the pad gets those of the gel, and its friction and
    stiffness, so that it grasps as well.
    """

    @property
    def body_name(self) -> str:
        """Name of the sensor's body in the scene."""
        return f"{self.name}/{self.sensor.base_body}"

    @property
    def gel_name(self) -> str:
        """Name of the gel's geom in the scene."""
        return self.replaced_pad or f"{self.name}/{self.sensor.gel_geom}"


def attach_tactile(spec: mujoco.MjSpec, placement: TactilePlacement) -> None:
    """Mount a tactile sensor on a body of a scene.

    Args:
        spec: The scene, changed in place.
        placement: The sensor and where it goes.

    Raises:
        InvalidSetup: The body is not in the scene, or has no such pad.
    """
    parent = spec.body(placement.parent_body)
    if parent is None:
        raise InvalidSetup(
            f"Tactile sensor {placement.name!r} is to be mounted on {placement.parent_body!r}, which is not there."
        )
    pad = None if placement.replaced_pad is None else _pad(parent, placement)
    frame = mount_frame(parent, placement.sensor_in_parent)
    spec.attach(load(placement.sensor), frame=frame, prefix=f"{placement.name}/")
    if pad is not None:
        gel = spec.geom(f"{placement.name}/{placement.sensor.gel_geom}")
        for field in CONTACT_FIELDS:
            setattr(gel, field, getattr(pad, field))
        _remove_pad(spec, parent, pad)
        gel.name = placement.replaced_pad
    # The sensor is a part of the finger: what the finger passes through without a contact, it does too.
    for exclude in list(spec.excludes):
        pair = [exclude.bodyname1, exclude.bodyname2]
        if placement.parent_body in pair:
            pair.remove(placement.parent_body)
            spec.add_exclude(bodyname1=placement.body_name, bodyname2=pair[0])


def _pad(parent: mujoco.MjsBody, placement: TactilePlacement) -> mujoco.MjsGeom:
    """Return the pad that the sensor replaces."""
    pads = [geom for geom in parent.geoms if geom.name == placement.replaced_pad]
    if not pads:
        raise InvalidSetup(
            f"Tactile sensor {placement.name!r} is to replace {placement.replaced_pad!r}; {placement.parent_body!r} "
            f"has {[geom.name for geom in parent.geoms if geom.name]}."
        )
    return pads[0]


def _remove_pad(spec: mujoco.MjSpec, parent: mujoco.MjsBody, pad: mujoco.MjsGeom) -> None:
    """Remove a pad and what is drawn in its place, which has no name."""
    place = np.array(pad.pos)
    for geom in list(parent.geoms):
        if geom.name == pad.name or (not geom.name and np.array_equal(geom.pos, place)):
            spec.delete(geom)
