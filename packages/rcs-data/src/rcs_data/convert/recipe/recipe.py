"""Recipes: what other projects' trainers need to learn from a dataset, made of the text templates beside this file.

A template begins with the format of the export and the name of the file that it becomes; then come the commands of the
user, and after a line of dashes the file itself.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from pprint import pformat
from string import Template
from typing import Any, Literal

from rcs_data.convert.options import ExportOptions, export_name, selected_cameras
from rcs_data.errors import InvalidSetup, UnknownName
from rcs_data.files.feature import Feature
from rcs_data.read.reader import Dataset
from rcs_data.read.trajectory import VectorLayout, action_layout, camera_features, state_layout

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

Meaning = Literal["absolute", "relative", "delta"]
"""Where to go, how far from the episode's origin, or how far from the action before; as in vlagents."""

_MEANINGS: dict[str, Meaning] = {"absolute": "absolute", "origin": "relative", "last_step": "delta"}
_ARMS = ("joints", "tquat", "xyzrpy")
_POSE = "xyzrpy"


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of a vector."""

    name: str
    """Such as "joints", or "left/joints" with several robots."""
    size: int
    """How many numbers it has."""
    unit: str
    """The unit of its numbers."""
    meaning: Meaning = "absolute"
    """The meaning of an action."""

    @property
    def is_arm(self) -> bool:
        """Whether it moves an arm."""
        return self.name.rpartition("/")[2] in _ARMS


@dataclass(frozen=True, kw_only=True)
class Contents:
    """The contents of a dataset for a policy: cameras, parts of state and action, and the meaning of an action."""

    name: str
    """The name of the dataset, in letters, digits and "_"."""
    digest: str
    """The hash of its episodes."""
    instruction: str
    """The instruction; an episode may have another."""
    rate: float
    """Steps per second [Hz]."""
    cameras: dict[str, tuple[int, int]]
    """Height and width [pixels] by camera."""
    state: tuple[Part, ...]
    """Parts of the state, in order."""
    action: tuple[Part, ...]
    """Parts of the action, in order."""

    @property
    def scene_camera(self) -> str:
        """The first camera that is not called after a wrist, which shows the scene; there must be one."""
        return next((name for name in self.cameras if "wrist" not in name.lower()), next(iter(self.cameras)))

    @property
    def wrist_cameras(self) -> tuple[str, ...]:
        """Cameras called after a wrist."""
        return tuple(name for name in self.cameras if "wrist" in name.lower() and name != self.scene_camera)

    def settings(self, *, images: dict[str, str], has_state: bool, **options: Any) -> str:
        """Return `vlagents.json`, with which the trained checkpoint is served.

        Args:
            images: Camera by the model's name of a picture.
            has_state: Whether the model observes the state.
            options: Options of the family besides.
        """
        values: dict[str, Any] = {"dataset": self.name, "data_hash": self.digest, "images": images}
        if has_state:
            values["state"] = [asdict(part) for part in self.state]
        values |= {"action": [asdict(part) for part in self.action], "rate": self.rate}
        return json.dumps(values | ({"options": options} if options else {}), indent=2) + "\n"


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


def recipe(family: Family, dataset: Dataset, options: ExportOptions | None = None, base: Base = "pi05") -> Recipe:
    """Return what a family's trainer needs, and `vlagents.json` to serve the result with.

    Args:
        family: Family of the policy that learns.
        dataset: The data that it learns from.
        options: How that is exported.
        base: The published model that openpi begins with.

    Raises:
        UnknownName: There is no such family or base.
        InvalidSetup: An option does not suit the dataset, or nobody knows what its actions mean; it has no camera, more
            than openpi sees, or actions that OpenVLA does not load.
    """
    makers = {"openpi": _openpi, "octo": _octo, "openvla": _openvla, **dict.fromkeys(_LEROBOT, _lerobot)}
    if family not in makers:
        raise UnknownName("family of policies", family, makers)
    if base not in _MODELS:
        raise UnknownName("model of openpi", base, _MODELS)
    contents = _contents(dataset, options or ExportOptions())
    if not contents.cameras:
        raise InvalidSetup("The dataset has no camera, and these policies look at pictures.")
    words, settings = makers[family](contents)
    words |= {
        "name": contents.name,
        "facts": _facts(contents),
        "base": base,
        "model": _MODELS[base],
        "state_size": sum(part.size for part in contents.state),
        "action_size": sum(part.size for part in contents.action),
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


def _contents(dataset: Dataset, options: ExportOptions) -> Contents:
    """Return what a policy learns from a dataset that is exported with these options."""
    info = dataset.info
    shown = camera_features(info)
    state, action = state_layout(info, options.state), action_layout(info, options.action)
    return Contents(
        name=export_name(dataset, options),
        digest=dataset.digest(),
        instruction=info.instruction,
        rate=info.frequency,
        cameras={name: (shown[name].shape[0], shown[name].shape[1]) for name in selected_cameras([*shown], options)},
        state=tuple(_part(feature) for feature in state.features),
        action=_action_parts(action, info.setup),
    )


def _part(feature: Feature) -> Part:
    return Part(name="/".join(feature.key.split("/")[1:]), size=feature.size, unit=feature.unit)


def _action_parts(layout: VectorLayout, setup: dict[str, Any]) -> tuple[Part, ...]:
    parts: list[Part] = []
    for feature in layout.features:
        part = _part(feature)
        if part.is_arm and feature.key.startswith("action/"):
            relative = setup.get("relative")
            if relative not in _MEANINGS:
                raise InvalidSetup(
                    f"The dataset's setup does not say what {feature.key!r} counts from: relative is {relative!r}; "
                    f"valid are {', '.join(_MEANINGS)}. With executed/{part.name} for the action, it is absolute."
                )
            part = replace(part, meaning=_MEANINGS[relative])
        parts.append(part)
    return tuple(parts)


def _lerobot(contents: Contents) -> _Words:
    """Return the words of a template, and the settings to serve the result with."""
    images = {camera.replace("/", "."): camera for camera in contents.cameras}
    return {"rows": max(round(SECONDS * contents.rate), 1)}, {"images": images, "has_state": True}


def _octo(contents: Contents) -> _Words:
    wrist = next(iter(contents.wrist_cameras), None)
    columns = {"primary": _column(contents.scene_camera), "wrist": None if wrist is None else _column(wrist)}
    images = {"image_primary": contents.scene_camera} | ({} if wrist is None else {"image_wrist": wrist})
    mask = [part.is_arm for part in contents.action for _ in range(part.size)]  # others are of grippers and hands
    words = {"images": pformat(columns, sort_dicts=False), "mask": repr(mask)}
    return words, {"images": images, "has_state": False}


def _openvla(contents: Contents) -> _Words:
    action = [(part.name.rpartition("/")[2], part.meaning) for part in contents.action]
    if action != [(_POSE, "delta"), ("gripper", "absolute")]:
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
