"""The mount of a tactile sensor, and how it replaces a finger's pad."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from rcs.errors import InvalidSetup
from rcs.kinematics.chain import load, mount_frame
from rcs.robots.description import Mount
from rcs.robots.tactile import TactileDescription
from rcs.spatial import Pose

CONTACT_FIELDS = ("condim", "friction", "solref", "solimp", "margin", "gap", "priority", "solmix")
"""Attributes that a gel takes over from the pad that it replaces: contact properties, not shape."""
UNFELT_GROUP = 5
"""Group of geoms that are neither visible nor felt."""


@dataclass(frozen=True, kw_only=True)
class TactilePlacement:
    """One tactile sensor and its mount."""

    name: str
    """Name in keys and prefixes, such as `left_touch`."""
    sensor: TactileDescription
    parent_body: str
    """Body of the scene that carries it; `world` if it is fixed."""
    sensor_in_parent: Mount
    """Pose of the sensor's frame (x out of the gel, z along its longer side) in the parent body's frame."""
    replaced_pad: str | None = None
    """Geom of the parent body that the gel replaces; None if nothing is in its way.

    The gel gets its name, so that queries for the pad's contacts find the gel, and its friction and stiffness, so that
    grasps hold as well. Other geoms of the finger in the gel's way are removed.
    """
    other_pads: tuple[str, ...] = ()
    """Other pads of the same finger: they keep their names but no longer collide."""

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
        placement: The sensor and its mount.

    Raises:
        InvalidSetup: The body is not in the scene, or it lacks the pad.
    """
    parent = spec.body(placement.parent_body)
    if parent is None:
        raise InvalidSetup(
            f"Tactile sensor {placement.name!r} is mounted on {placement.parent_body!r}, which is not in the scene."
        )
    pad = None if placement.replaced_pad is None else _pad(parent, placement)
    frame = mount_frame(parent, placement.sensor_in_parent)
    spec.attach(load(placement.sensor), frame=frame, prefix=f"{placement.name}/")
    if pad is not None:
        gel = spec.geom(f"{placement.name}/{placement.sensor.gel_geom}")
        for field in CONTACT_FIELDS:
            setattr(gel, field, getattr(pad, field))
        _clear_way(spec, parent, pad, placement)
        spec.delete(pad)
        gel.name = placement.replaced_pad
    for name in placement.other_pads:
        _retire(spec.geom(name))
    # The sensor is part of the finger, so it shares the finger's contact exclusions.
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
            f"Tactile sensor {placement.name!r} cannot replace {placement.replaced_pad!r}; {placement.parent_body!r}  "
            f"has {[geom.name for geom in parent.geoms if geom.name]}."
        )
    return pads[0]


def _clear_way(spec: mujoco.MjSpec, parent: mujoco.MjsBody, pad: mujoco.MjsGeom, placement: TactilePlacement) -> None:
    """Remove visuals inside of a pad, and geoms of its finger inside of the sensor that reach into the gel.

    Geoms centred elsewhere carry the sensor and stay. Named geoms stay for lookups, but no longer collide.
    """
    model = spec.copy().compile()  # compiled, since a file may give geoms by their ends or by angles
    sensor, mount = placement.sensor, placement.sensor_in_parent
    in_sensor = Pose(mount.translation, mount.quaternion).inverse()
    depth = sensor.gel_center[0] - sensor.camera_position[0]
    # A box that the housing and the gel fill, with half of its edges.
    middle = np.array(sensor.gel_center) - [0.5 * depth, 0.0, 0.0]
    edges = 0.5 * np.array([depth, sensor.gel_width, sensor.gel_height])
    pad_index = model.geom(pad.name).id
    in_pad = _pose_of(model, pad_index).inverse()
    first = int(model.body(parent.name).geomadr[0])
    for index, geom in enumerate(list(parent.geoms), first):
        if geom.name == pad.name or geom.name in placement.other_pads:
            continue
        box, pose = model.geom_aabb[index], _pose_of(model, index)
        place = pose * Pose(box[:3])
        is_pad = (np.abs((in_pad * place).translation) < model.geom_aabb[pad_index, 3:]).all()
        is_inside = (np.abs((in_sensor * place).translation - middle) < edges).all()
        front = (in_sensor * place).translation[0] + np.abs((in_sensor * pose).matrix[0, :3]) @ box[3:]
        if not is_pad and not (is_inside and front > sensor.gel_center[0] - sensor.gel_bulge):
            continue
        if geom.name:
            _retire(geom)
        else:
            spec.delete(geom)


def _pose_of(model: mujoco.MjModel, geom: int) -> Pose:
    """Return the pose of a geom in its body."""
    return Pose(model.geom_pos[geom], np.roll(model.geom_quat[geom], -1))


def _retire(geom: mujoco.MjsGeom) -> None:
    """Make a geom invisible, without contacts, and not felt."""
    geom.contype = geom.conaffinity = 0
    geom.group = UNFELT_GROUP
