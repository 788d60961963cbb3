"""Recipes: what other projects' trainers need to learn from a dataset, made of the text templates beside this file.

A template begins with the format of the export and the name of the file that it becomes; then come the commands of the
user, and after a line of dashes the file itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from pprint import pformat
from string import Template
from typing import Any, Literal

from rcs_data.convert.recipe.contents import POSE, Contents
from rcs_data.errors import InvalidSetup, UnknownName

Family = Literal["act", "diffusion", "smolvla", "openpi", "octo", "openvla"]
LerobotPolicy = Literal["act", "diffusion", "smolvla"]
"""Families that LeRobot trains."""
Base = Literal["pi0", "pi05", "pi0_fast"]
SECONDS = 1.0
"""Length of ACT's chunk [s]."""

# The models of openpi, and the pictures that they see.
_MODELS: dict[str, str] = {
    "pi0": "pi0_config.Pi0Config(action_horizon=16)",
    "pi05": "pi0_config.Pi0Config(pi05=True, action_horizon=16)",
    "pi0_fast": "pi0_fast.Pi0FASTConfig(action_dim=ACTION_SIZE, action_horizon=16)",
}
_SLOTS = ("base_0_rgb", "left_wrist_0_rgb", "right_wrist_0_rgb")


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Files for a trainer, and how to use them."""

    files: Mapping[str, str]
    """Text by file name."""
    export_format: str
    """Format of `rcs-data export` that the trainer reads."""
    steps: tuple[str, ...]
    """Commands, in order; FOLDER is where the files are, and words in capitals are yours to fill in."""

    def write(self, folder: Path) -> None:
        """Write the files; those of an earlier call are replaced."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in self.files.items():
            (folder / name).write_text(text, encoding="utf-8")


def recipe(family: Family, contents: Contents, base: Base = "pi05") -> Recipe:
    """Return what a family's trainer needs, and `vlagents.json` to serve the result with.

    Args:
        family: Family of the policy that learns.
        contents: The data that it learns from.
        base: The published model that openpi begins with.

    Raises:
        UnknownName: There is no such family or base.
        InvalidSetup: The dataset has no camera, more than openpi sees, or actions that OpenVLA does not load.
    """
    makers = {"openpi": _openpi, "octo": _octo, "openvla": _openvla, **dict.fromkeys(_LEROBOT, _lerobot)}
    if family not in makers:
        raise UnknownName("family of policies", family, makers)
    if base not in _MODELS:
        raise UnknownName("model of openpi", base, _MODELS)
    if not contents.cameras:
        raise InvalidSetup("The dataset has no camera, and these policies look at pictures.")
    words, settings = makers[family](contents)
    words |= {
        "name": contents.name,
        "facts": _facts(contents),
        "base": base,
        "model": _MODELS[base],
        "state_size": contents.state_size,
        "action_size": contents.action_size,
    }
    head, _, body = Path(__file__).with_name(f"{family}.txt").read_text("utf-8").partition("\n---\n")
    first, *steps = head.split("\n")
    export_format, file = first.split()
    return Recipe(
        files={file: Template(body).substitute(words), "vlagents.json": contents.settings(**settings)},
        export_format=export_format,
        steps=tuple(Template(step).substitute(words) for step in steps),
    )


_LEROBOT = ("act", "diffusion", "smolvla")
_Words = tuple[dict[str, Any], dict[str, Any]]


def _lerobot(contents: Contents) -> _Words:
    """Return the words of a template, and the settings to serve the result with."""
    images = {camera.replace("/", "."): camera for camera in contents.cameras}
    return {"rows": max(round(SECONDS * contents.rate), 1)}, {"images": images, "has_state": True}


def _octo(contents: Contents) -> _Words:
    wrist = next(iter(contents.wrist_cameras), None)
    columns = {"primary": _column(contents.scene_camera), "wrist": None if wrist is None else _column(wrist)}
    images = {"image_primary": contents.scene_camera} | ({} if wrist is None else {"image_wrist": wrist})
    words = {"images": pformat(columns, sort_dicts=False), "mask": repr(contents.arm_mask)}
    return words, {"images": images, "has_state": False}


def _openvla(contents: Contents) -> _Words:
    action = [(part.name.rpartition("/")[2], part.meaning) for part in contents.action]
    if action != [(POSE, "delta"), ("gripper", "absolute")]:
        found = ", ".join(f"{part.name} ({part.meaning})" for part in contents.action)
        raise InvalidSetup(
            f"OpenVLA loads actions that are xyzrpy relative to the last step and gripper; this dataset has {found}. "
            "Collect with --control xyzrpy, and without --relative absolute."
        )
    scene = contents.scene_camera
    return {"image": repr(_column(scene))}, {"images": {"image": scene}, "has_state": False, "center_crop": True}


def _openpi(contents: Contents) -> _Words:
    scene = contents.scene_camera
    rest = [*contents.wrist_cameras, *(name for name in contents.cameras if name not in contents.wrist_cameras)]
    order = [scene, *(name for name in rest if name != scene)]
    if len(order) > len(_SLOTS):
        raise InvalidSetup(
            f"The dataset has {len(order)} cameras ({', '.join(contents.cameras)}), and openpi's models see three; "
            "choose with --cameras."
        )
    keys = {camera: f"observation/{camera}" for camera in contents.cameras}
    columns = {key: f"observation.images.{camera.replace('/', '.')}" for camera, key in keys.items()}
    words = {
        "slots": pformat({slot: keys[camera] for slot, camera in zip(_SLOTS, order, strict=False)}, sort_dicts=False),
        "columns": pformat(columns, sort_dicts=False),
        "delta": repr(_delta_mask(contents)),
    }
    images = {key: camera for camera, key in keys.items()}
    return words, {"images": images, "has_state": True, "layout": "own", "config": "openpi_config.py"}


def _column(camera: str) -> str:
    """Return the name of a camera's pictures in our RLDS."""
    return f"image_{camera.replace('/', '_')}"


def _delta_mask(contents: Contents) -> list[bool] | None:
    """Return which numbers of an action become relative to the state, for openpi learns that best; None for none.

    Those are absolute joints that the state has in the same place. openpi subtracts number by number, so poses with
    quaternions or angles that wrap stay as they are.
    """
    mask: list[bool] = []
    for action, state in zip(contents.action, contents.state, strict=False):
        if (action.name, action.size) != (state.name, state.size):  # what follows is in another place
            break
        is_joints = action.name.rpartition("/")[2] == "joints" and action.meaning == "absolute"
        mask += [is_joints] * action.size
    while mask and not mask[-1]:  # openpi leaves numbers beyond the mask as they are
        del mask[-1]
    return mask or None


def _facts(contents: Contents) -> str:
    """Return what the dataset is, as lines of a comment."""
    lines = [f"Instruction: {contents.instruction}".rstrip(), f"Rate: {contents.rate:g} Hz"]
    lines += [f"Camera {name}: {height} x {width}" for name, (height, width) in contents.cameras.items()]
    for what, parts in (("State", contents.state), ("Action", contents.action)):
        lines += [f"{what} {p.name}: {p.size} numbers, {p.unit or 'no unit'}, {p.meaning}" for p in parts]
    return "\n".join(f"# {' '.join(line.split())}" for line in lines)
