"""Published figures of robots, as JSON files, and the poses in their tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rcs.spatial import Pose, normalize, wxyz_to_xyzw


def read_figures(robot: str) -> dict[str, Any]:
    """Return the published figures that the model of a robot must reproduce."""
    return json.loads((Path(__file__).parent / "data" / f"{robot}.json").read_text())


def pose_of(row: dict[str, Any]) -> Pose:
    """Return the pose in a row of a published table, with whatever names and form of rotation it has."""
    translation = row.get("xyz", row.get("position", (0.0, 0.0, 0.0)))
    if "rpy" in row:
        return Pose.from_rpy(translation, row["rpy"])
    quaternion = wxyz_to_xyzw(row.get("quat_wxyz", row.get("quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))))
    return Pose.from_tquat(normalize([*translation, *quaternion]))
