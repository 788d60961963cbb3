"""Settings that complete a checkpoint: the camera of each image, the dataset of the statistics, the parts of an action.

Checkpoints of most families have weights and statistics, but no names of inputs. These are in the file `vlagents.json`
in the checkpoint's folder, or in one given with `vlagents serve --settings`:

    {
      "dataset": "pick_cuboid",
      "data_hash": "5f0c…",
      "images": {"image_primary": "side", "image_wrist": "wrist"},
      "state": [{"name": "joints", "size": 7, "unit": "rad"}],
      "action": [{"name": "xyzrpy", "size": 6, "unit": "m, rad", "meaning": "delta"},
                 {"name": "gripper", "size": 1, "unit": "0 closed, 1 open"}],
      "rate": 10
    }
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from vlagents.errors import InvalidInput
from vlagents.metadata import PartSpec
from vlagents.record import Hertz, Name, Record

FILE = "vlagents.json"
"""Name of the file in a checkpoint's folder."""
DELTA_POSE = (PartSpec("xyzrpy", 6, "m, rad", "delta"), PartSpec("gripper", 1, "0 closed, 1 open"))
"""Actions of Open X-Embodiment, from which Octo and OpenVLA have learned: how far the TCP moves in a step, in the base
frame, as translation and roll-pitch-yaw, and where the gripper goes."""


@dataclass(frozen=True, kw_only=True)
class Settings(Record):
    """Names of a checkpoint's inputs and outputs on the robot."""

    dataset: str = ""
    """Dataset whose statistics bring actions back to physical units. Optional where the checkpoint has one dataset."""
    data_hash: str = ""
    """Hash of the dataset that the checkpoint was trained on."""
    images: Mapping[str, Name] = field(default_factory=dict)
    """Camera by the model's name of an image; by default the same name."""
    state: tuple[PartSpec, ...] = ()
    """Parts of the state, in the model's order."""
    action: tuple[PartSpec, ...] = ()
    """Parts of an action, in the order of its numbers; empty for those that are usual in the family."""
    rate: Hertz = 0.0
    """Actions per second of the training data [Hz]; 0 for the rate that is usual in the family."""
    device: str = ""
    """Device of the model, such as `cuda:0` or `cpu`; empty for a GPU if there is one. JAX chooses by itself."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """More options of a family; its module lists them."""

    @classmethod
    def read(cls, checkpoint: str | Path, file: str | Path | None = None) -> Settings:
        """Return a checkpoint's settings; the defaults where its folder has none.

        Args:
            checkpoint: A folder, or a name that is no path on this machine.
            file: The settings, instead of those in the folder.

        Raises:
            InvalidInput: The named file is missing, or something in it is wrong.
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
    def from_dict(cls, values: object) -> Settings:
        """Read settings from plain values.

        Raises:
            InvalidInput: A name is unknown or a value is wrong.
        """
        known = [item.name for item in fields(cls)]
        if not isinstance(values, Mapping) or not all(name in known for name in values):
            names = ", ".join(map(str, values)) if isinstance(values, Mapping) else type(values).__name__
            raise InvalidInput(f"The settings have {names}; valid are {', '.join(known)}.")
        return super().from_dict(values)

    def camera(self, image: str) -> str:
        """Return the camera of an image, by the model's name of it."""
        return self.images.get(image, image)

    def check_images(self, images: list[str]) -> None:
        """Refuse cameras for images that the model does not take.

        Raises:
            InvalidInput: There are some.
        """
        wrong = sorted(set(self.images) - set(images))
        if wrong:
            raise InvalidInput(f"The settings have a camera for {wrong}; the model's images are {sorted(images)}.")

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
        named = f"{what} is {dataset!r}" if dataset else f"No {what} is named in the settings"
        raise InvalidInput(
            f"{named}, and the checkpoint has statistics of {', '.join(sorted(known)) or 'none'}. Name one of them as "
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
