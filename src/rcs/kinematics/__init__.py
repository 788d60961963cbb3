"""Forward and inverse kinematics of a robot from its description."""

from rcs._core import DampedLeastSquares, IkOptions, IkResult, IkStatus, Kinematics
from rcs.kinematics.chain import attach_end_effector, kinematics_of, load

__all__ = [
    "DampedLeastSquares",
    "IkOptions",
    "IkResult",
    "IkStatus",
    "Kinematics",
    "attach_end_effector",
    "kinematics_of",
    "load",
]
