"""Where on a table a task takes place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Area:
    """A rectangle on the table in which a task takes place."""

    center: tuple[float, float] = (0.5, 0.0)
    """x, y in the scene [m]; with one robot, its base frame is the scene's."""
    size: tuple[float, float] = (0.30, 0.40)
    """Extent along x and y [m]."""
    object_scale: float = 1.0
    """Size of the objects in proportion to the paper's, for robots that are smaller."""
