"""A fixed pose of one part in the frame of another, and boxes at such poses, as plain numbers."""

from __future__ import annotations

import math

from rcs_data.options import Positive, Record, Share

from rcs.errors import InvalidSetup
from rcs.spatial import Pose


class Mount(Record):
    """A fixed pose of one part in the frame of another."""

    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin of the part in the parent's frame [m]."""
    quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    """Rotation from the part's frame to the parent's frame, xyzw; brought to unit norm."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            InvalidSetup: A length is wrong, a number is not finite, or the quaternion's norm is more than 1e-3 off 1.
        """
        super().__post_init__()
        norm = math.hypot(*self.quaternion)
        if abs(norm - 1.0) > 1e-3:
            raise InvalidSetup(f"quaternion has norm {norm!r}; a rotation needs norm 1 (xyzw).")
        if abs(norm - 1.0) > 1e-9:  # written with few digits
            object.__setattr__(self, "quaternion", tuple(value / norm for value in self.quaternion))

    @staticmethod
    def of(pose: Pose) -> Mount:
        """Return the mount of a pose."""
        (x, y, z), (i, j, k, w) = pose.translation.tolist(), pose.quaternion.tolist()
        return Mount(translation=(x, y, z), quaternion=(i, j, k, w))

    @property
    def pose(self) -> Pose:
        """The mount as a `Pose`."""
        return Pose(self.translation, self.quaternion)


class Obstacle(Record):
    """A box that stands still in the scene."""

    size: tuple[Positive, Positive, Positive]
    """Lengths of its edges along its x, y and z [m]."""
    pose: Mount
    """Pose of its centre in the scene, whose origin is on the table top."""
    colour: tuple[Share, Share, Share] = (0.45, 0.47, 0.50)
    """Red, green and blue, 0 … 1."""
