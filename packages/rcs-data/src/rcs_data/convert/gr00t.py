"""The file that GR00T needs beside a LeRobot v2 dataset: the meaning of the vectors' numbers."""

from __future__ import annotations

from typing import Any

from rcs_data.convert.lerobot_layout import IMAGES, LeRobotLayout
from rcs_data.trajectory import VectorLayout

MODALITY_FILE = "meta/modality.json"


def modality(layout: LeRobotLayout) -> dict[str, Any]:
    """Return `modality.json`: parts of state and action by name, cameras, and the instruction.

    Layout: the "Robot Data Preparation Guide" of NVIDIA's Isaac-GR00T.
    """
    state, action = layout.columns[0].parts, layout.columns[1].parts
    return {
        "state": _parts(state),
        "action": _parts(action),
        "video": {name.removeprefix(IMAGES): {"original_key": name} for name in layout.cameras},
        "annotation": {"human.task_description": {"original_key": "task_index"}},
    }


def _parts(vector: VectorLayout) -> dict[str, dict[str, int]]:
    # "left_joints" for "observation/left/joints", as in the names of the vector's numbers.
    return {
        "_".join(key.split("/")[1:]): {"start": part.start, "end": part.stop} for key, part in vector.slices.items()
    }
