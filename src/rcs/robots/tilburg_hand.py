"""The figures of the Tilburg Hand, the right one.

Joints have the driver's names and order, the tip of a finger first: IP, MCP, abduction and CMC of the thumb, then DIP,
PIP, MCP and abduction of index, middle and ring finger. The driver's two optional wrist joints are not part of it.
"""

from __future__ import annotations

from math import radians, sqrt
from typing import Final

from rcs.robots.description import HandDescription, Mount

_Four = tuple[float, float, float, float]

# Driver of tilburg-hand 1.1.0, default calibration of its motors [degrees]: positions at 0 and at 1.
_THUMB_RANGE = ((-5.0, 95.0), (0.0, 90.0), (0.0, 100.0), (0.0, 90.0))
_FINGER_RANGE = ((-5.0, 95.0), (-5.0, 95.0), (0.0, 95.0), (-25.0, 25.0))
_RANGES = (*_THUMB_RANGE, *_FINGER_RANGE, *_FINGER_RANGE, *_FINGER_RANGE)

_JOINTS = (
    *("thumb_ip", "thumb_mcp", "thumb_abd", "thumb_cmc"),
    *("index_dip", "index_pip", "index_mcp", "index_abd"),
    *("middle_dip", "middle_pip", "middle_mcp", "middle_abd"),
    *("ring_dip", "ring_pip", "ring_mcp", "ring_abd"),
)


def _normalised(*, thumb: _Four, index: _Four, middle: _Four, ring: _Four) -> tuple[float, ...]:
    """Return joint positions [degrees, in the order of the joints] as fractions of the joints' ranges."""
    degrees = (*thumb, *index, *middle, *ring)
    return tuple((angle - low) / (high - low) for angle, (low, high) in zip(degrees, _RANGES, strict=True))


_BENT: _Four = (45.0, 80.0, 10.0, 0.0)
"""A finger that arches over the object to grasp."""
_CLOSED: _Four = (41.0, 60.0, 78.0, 0.0)
_CURLED: _Four = (40.0, 60.0, 90.0, 0.0)

TILBURG_HAND: Final = HandDescription(
    name="tilburg_hand",
    label="Tilburg Hand",
    module=__name__,
    mjcf_file="tilburg_hand.xml",
    base_body="hand",
    # The package defines no flange. The vendor's base ends in the disc of a wrist that turns the hand by a right angle,
    # centred on the origin and in the plane z = 0: it lies on the flange. Our choice is the turn about the flange's
    # axis, the fingers point along its x axis. The palm then faces away from the flange.
    mount_in_flange=Mount(quaternion=(0.0, 0.0, -sqrt(0.5), sqrt(0.5))),
    tcp_site="tcp",
    # Our choice: 8 cm before the palm, 5 cm or more from every finger of the open hand, so that a toy of 8 cm fits
    # between them; a power grasp draws it 1 to 2 cm towards the thumb. The axes are the flange's: x along the fingers,
    # z out of the palm.
    tcp_in_base=Mount(translation=(0.02, 0.115, 0.15), quaternion=(0.0, 0.0, sqrt(0.5), sqrt(0.5))),
    joints=_JOINTS,
    actuators=_JOINTS,
    joint_lower=tuple(radians(low) for low, _ in _RANGES),
    joint_upper=tuple(radians(high) for _, high in _RANGES),
    # The package defines no grasps; these are ours, found by simulation. With the TCP at least 25 mm above a table, the
    # hand opens and closes without touching it.
    open_pose=_normalised(thumb=(75.0, 25.0, 0.0, 50.0), index=_BENT, middle=_BENT, ring=_BENT),
    grasps={
        "power": _normalised(thumb=(48.0, 48.0, 29.0, 54.0), index=_CLOSED, middle=_CLOSED, ring=_CLOSED),
        "precision": _normalised(
            thumb=(31.0, 60.0, 27.0, 33.0), index=(33.0, 65.0, 75.0, 0.0), middle=_BENT, ring=_BENT
        ),
        "lateral": _normalised(thumb=(27.0, 54.0, 91.0, 88.0), index=_CURLED, middle=_CURLED, ring=_CURLED),
        "tripod": _normalised(
            thumb=(40.0, 52.0, 29.0, 50.0), index=(38.0, 62.0, 77.0, 0.0), middle=(38.0, 62.0, 77.0, 0.0), ring=_BENT
        ),
    },
    finger_geoms={
        "thumb": ("thumb_proximal", "thumb_distal"),
        "index": ("index_proximal", "index_middle", "index_distal"),
        "middle": ("middle_proximal", "middle_middle", "middle_distal"),
        "ring": ("ring_proximal", "ring_middle", "ring_distal"),
    },
    sources=(
        "tilburg-hand 1.1.0, robot.xml (MIT): kinematics, inertias, joint friction, torque limit 0.35 Nm",
        "tilburg-hand 1.1.0, robot.urdf (MIT): mass of the base 0.282 kg and its inertia, joint speed 8 rad/s",
        "tilburg-hand 1.1.0, motor_interface.py (MIT): order, names and ranges of the joints",
        "mujoco_menagerie ufactory_xarm7 hand (BSD-3-Clause): friction and stiffness of the fingers",
    ),
)
"""The Tilburg Hand, right; 0.63 kg."""
