"""Ranges and speeds that the joints of an arm can reach, stored with the column that has their positions."""

from __future__ import annotations

from rcs_data.errors import InvalidSetup
from rcs_data.files.text import check_text
from rcs_data.options import Record


class JointBounds(Record):
    """Ranges and speeds of an arm's joints, with which its recorded positions are checked.

    Raises:
        InvalidSetup: The numbers are not finite, or not one per joint.
    """

    arm: str
    """The arm in words, such as "Franka Research 3"."""
    names: tuple[str, ...]
    """The joints, in the order of the column."""
    lower: tuple[float, ...]
    """Lower ends of their ranges [rad]."""
    upper: tuple[float, ...]
    """Upper ends of their ranges [rad]."""
    velocity: tuple[float, ...]
    """Largest speeds [rad/s]."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        for text in (self.arm, *self.names):
            check_text(text, "A name in joint limits")
        for field in ("lower", "upper", "velocity"):
            if len(getattr(self, field)) != len(self.names):
                raise InvalidSetup(
                    f"Joint limits have {field} {getattr(self, field)}; it must be {len(self.names)} finite numbers, "
                    "one per joint."
                )
