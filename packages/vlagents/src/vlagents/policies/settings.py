"""What a checkpoint does not say of itself: which camera is which picture, whose statistics hold, what an action means.

Checkpoints of most families have weights and statistics, and leave to who uses them how their inputs are called. The
file `vlagents.json` in the checkpoint's folder, or one given with `vlagents serve --settings`, says it:

    {
      "dataset": "pick_cuboid",
      "images": {"image_primary": "side", "image_wrist": "wrist"},
      "state": [{"name": "joints", "size": 7, "unit": "rad"}],
      "action": [{"name": "xyzrpy", "size": 6, "unit": "m, rad", "meaning": "delta"},
                 {"name": "gripper", "size": 1, "unit": "0 closed, 1 open"}],
      "rate": 10
    }
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from vlagents.errors import InvalidInput
from vlagents.metadata import Metadata, PartSpec

FILE = "vlagents.json"
"""Name of the file in a checkpoint's folder."""
DELTA_POSE = (PartSpec("xyzrpy", 6, "m, rad", "delta"), PartSpec("gripper", 1, "0 closed, 1 open"))
"""Actions of Open X-Embodiment, from which Octo and OpenVLA have learned: how far the TCP goes in a step, in the frame
of the base, as translation and roll-pitch-yaw, and where the gripper goes."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How a checkpoint's inputs and outputs are called on the robot."""

    dataset: str = ""
    """Whose statistics bring actions back to physical units. May be left out where the checkpoint knows one dataset."""
    images: Mapping[str, str] = field(default_factory=dict)
    """Camera by the model's name of a picture. What is left out is called as the model calls it."""
    state: tuple[PartSpec, ...] = ()
    """Parts of the state, in the order in which the model has learned them."""
    action: tuple[PartSpec, ...] = ()
    """Parts of an action, in the order of its numbers; empty for what is usual in the family."""
    rate: float = 0.0
    """Actions per second of the data that the model has learned from [Hz]; 0 for what is usual in the family."""
    device: str = ""
    """Where the model runs, such as `cuda:0` or `cpu`; empty for a GPU if there is one. JAX chooses by itself."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """What a family asks for besides; its file says what that is."""

    def __post_init__(self) -> None:
        """Check types.

        Raises:
            InvalidInput: One is wrong.
        """
        for name in ("dataset", "device"):
            if not isinstance(getattr(self, name), str):
                raise InvalidInput(f"{name} of the settings is {getattr(self, name)!r}; valid is a str.")
        for name in ("images", "options"):
            if not isinstance(getattr(self, name), Mapping):
                raise InvalidInput(f"{name} of the settings is {getattr(self, name)!r}; valid is a dictionary.")
        if not all(isinstance(camera, str) and camera for camera in self.images.values()):
            raise InvalidInput(f"images of the settings are {dict(self.images)}; valid are names of cameras.")
        is_number = isinstance(self.rate, (int, float)) and not isinstance(self.rate, bool)
        if not is_number or not math.isfinite(self.rate) or self.rate < 0:
            raise InvalidInput(f"rate of the settings is {self.rate!r}; valid is a number of hertz, or 0.")

    @classmethod
    def read(cls, checkpoint: str | Path, file: str | Path | None = None) -> Settings:
        """Return a checkpoint's settings; the defaults where its folder has none.

        Args:
            checkpoint: A folder, or what is no path on this machine.
            file: The settings, instead of those in the folder.

        Raises:
            InvalidInput: The file is missing although it was named, or something in it is wrong.
        """
        path = Path(file) if file else Path(checkpoint) / FILE
        if not file and not path.is_file():
            return cls()
        try:
            return cls.from_dict(json.loads(path.read_text(encoding="utf-8")))
        except (OSError, UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
            raise InvalidInput(f"The settings {path} cannot be read: {error}") from error
        except InvalidInput as error:
            raise InvalidInput(f"{path}: {error}") from error

    @classmethod
    def from_dict(cls, given: object) -> Settings:
        """Read what JSON holds.

        Raises:
            InvalidInput: Something is wrong; a name that is not known is, too.
        """
        known = [item.name for item in fields(cls)]
        if not isinstance(given, Mapping) or not all(name in known for name in given):
            came = ", ".join(map(str, given)) if isinstance(given, Mapping) else type(given).__name__
            raise InvalidInput(f"The settings have {came}; valid are {', '.join(known)}.")
        values = dict(given)
        for what in ("state", "action"):
            if what in values:
                # A policy's metadata know how to read parts, and check them.
                parts = {"name": "settings", "action": values[what]}
                values[what] = Metadata.from_dict(parts).action
        return cls(**values)

    def camera(self, picture: str) -> str:
        """Return the camera of a picture, by the model's name of it."""
        return self.images.get(picture, picture)

    def check_images(self, pictures: list[str]) -> None:
        """Refuse cameras for pictures that the model does not take.

        Raises:
            InvalidInput: There are some.
        """
        wrong = sorted(set(self.images) - set(pictures))
        if wrong:
            raise InvalidInput(f"The settings have a camera for {wrong}; the model's pictures are {sorted(pictures)}.")

    def option(self, name: str, default: Any) -> Any:
        """Return an option, of the type that its default has.

        Raises:
            InvalidInput: It is of another type.
        """
        value = self.options.get(name, default)
        is_number = isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool)
        if type(value) is not type(default) and not is_number:
            raise InvalidInput(f"The option {name!r} is {value!r}; valid is a {type(default).__name__}.")
        return float(value) if is_number else value

    def check_options(self, known: tuple[str, ...]) -> None:
        """Refuse options that the family does not have.

        Raises:
            InvalidInput: There are some.
        """
        wrong = sorted(set(self.options) - set(known))
        if wrong:
            raise InvalidInput(f"There are no options {wrong}; valid: {', '.join(known) or 'none'}.")


def chosen(dataset: str, known: list[str], what: str = "dataset") -> str:
    """Return the dataset whose statistics hold.

    Raises:
        InvalidInput: None was named and there are several, or the one that was named is not among them.
    """
    if not dataset and len(known) == 1:
        return known[0]
    if dataset not in known:
        came = f"{what} is {dataset!r}" if dataset else f"No {what} is named in the settings"
        raise InvalidInput(
            f"{came}, and the checkpoint has statistics of {', '.join(sorted(known)) or 'none'}. Name one of them as "
            f"`dataset` in {FILE}: another one's would give actions of another size and scale."
        )
    return dataset


def check_parts(what: str, parts: tuple[PartSpec, ...], size: int) -> None:
    """Refuse parts whose numbers are not as many as the model's.

    Raises:
        InvalidInput: They differ.
    """
    total = sum(part.size for part in parts)
    if total != size:
        named = ", ".join(f"{part.name} ({part.size})" for part in parts) or "none"
        raise InvalidInput(
            f"The model's {what} has {size} numbers; the settings name {named}, {total} together. Name its parts as "
            f"`{what}` in {FILE}, in their order."
        )
