"""Where a tactile sensor is mounted, and how it takes the place of a finger's pad."""

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
"""What a gel takes over from the pad that it replaces: how it holds, not its shape."""
UNFELT_GROUP = 5
"""Group of geoms that are neither seen nor felt."""


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
    stiffness, so that it grasps as well. What else of the finger is in the gel's way is left out.
    """
    other_pads: tuple[str, ...] = ()
    """More pads of the same finger: they keep their names and no longer touch anything."""

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
        _clear_way(spec, parent, pad, placement)
        spec.delete(pad)
        gel.name = placement.replaced_pad
    for name in placement.other_pads:
        _retire(spec.geom(name))
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


def _clear_way(spec: mujoco.MjSpec, parent: mujoco.MjsBody, pad: mujoco.MjsGeom, placement: TactilePlacement) -> None:
    """Leave out what is drawn inside of a pad, and what of its finger is inside of the sensor and reaches into the gel.

    What has its middle elsewhere carries the sensor and stays. So does a geom with a name, for those who look it up,
    but it no longer touches.
    """
    model = spec.copy().compile()  # only here it is known where geoms are that a file gives by their ends or by angles
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
    """Make a geom neither touch, nor be felt, nor be seen."""
    geom.contype = geom.conaffinity = 0
    geom.group = UNFELT_GROUP
