"""What of an environment a learner reads and writes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

from rcs.errors import InvalidSetup, require_fields

Feature = Literal["offset", "near", "relative_turn", "half_turn"]
"""What is told of pairs of poses beside the poses, from each TCP, and from its target where that is observed, to each
object, and from an object to the next; see `rcs.rl.layout.Kind`."""


@dataclass(frozen=True, kw_only=True)
class Selection:
    """What goes into the vectors of a `Flat`. `to_json` and `from_json` are inverse to each other."""

    keys: tuple[str, ...] | None = None
    """Keys of the state, such as `joints`, `privileged/cuboid` or, of several robots, `left`; a key with others inside
    means all of these. None for all but `xyzrpy`, which says the same as `tquat`."""
    actions: tuple[str, ...] | None = None
    """Numbers of the action, such as `gripper`, `xyzrpy[0:3]`, `xyzrpy[5]` or `left/joints`, at least one of each key.
    The others are always in the middle of their bounds: of relative actions, 0. None for all."""
    features: tuple[Feature, ...] = get_args(Feature)
    """What is told of pairs of poses. It follows from the poses, but is hard to learn."""
    cameras: tuple[str, ...] | None = None
    """Names of the cameras whose frames are observed; None for all."""

    def __post_init__(self) -> None:
        """Check names, and turn sequences into tuples.

        Raises:
            InvalidSetup: A field is not a sequence of texts, or a feature is unknown.
        """
        for own in dataclasses.fields(self):
            value: Any = getattr(self, own.name)
            if value is None and own.name != "features":
                continue
            if isinstance(value, str):
                raise InvalidSetup(f"{own.name} is the text {value!r}; give a sequence, such as [{value!r}].")
            if not isinstance(value, Sequence) or not all(isinstance(one, str) for one in value):
                raise InvalidSetup(f"{own.name} is {value!r}; valid is a sequence of names.")
            object.__setattr__(self, own.name, tuple(value))
        if unknown := [name for name in self.features if name not in get_args(Feature)]:
            raise InvalidSetup(f"features has {unknown}; valid: {', '.join(map(repr, get_args(Feature)))}.")

    def to_json(self) -> dict[str, Any]:
        """Return the selection as JSON values."""
        values = dataclasses.asdict(self)
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}

    @staticmethod
    def from_json(values: Mapping[str, Any]) -> Selection:
        """Return the selection that `to_json` wrote.

        Raises:
            InvalidSetup: A key is unknown or a value is not valid.
        """
        require_fields("field of a selection", values, (own.name for own in dataclasses.fields(Selection)))
        return Selection(**values)
