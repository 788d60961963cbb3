"""The contents of a dataset for a policy: cameras, parts of state and action, and the meaning of an action."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from rcs_data.convert.options import ExportOptions, export_name, selected_cameras
from rcs_data.errors import InvalidSetup
from rcs_data.files.feature import Feature
from rcs_data.read.reader import Dataset
from rcs_data.read.trajectory import VectorLayout, action_layout, camera_features, state_layout

Meaning = Literal["absolute", "relative", "delta"]
"""Where to go, how far from the episode's origin, or how far from the action before; as in vlagents."""

_MEANINGS: dict[str, Meaning] = {"absolute": "absolute", "origin": "relative", "last_step": "delta"}
_ARMS = ("joints", "tquat", "xyzrpy")
POSE = "xyzrpy"


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
    """The contents of a dataset for a policy."""

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
    def state_size(self) -> int:
        """Numbers of the state."""
        return sum(part.size for part in self.state)

    @property
    def action_size(self) -> int:
        """Numbers of an action."""
        return sum(part.size for part in self.action)

    @property
    def arm_mask(self) -> list[bool]:
        """Whether each number of an action is an arm's; the others are of grippers and hands."""
        return [part.is_arm for part in self.action for _ in range(part.size)]

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


def contents(dataset: Dataset, options: ExportOptions | None = None) -> Contents:
    """Return what a policy learns from a dataset that is exported with these options.

    Raises:
        InvalidSetup: An option does not suit the dataset, or the meaning of its actions is not known.
    """
    options = options or ExportOptions()
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
