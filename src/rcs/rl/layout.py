"""What the numbers of a flat vector are: of every entry its key, place, offset, scale, bounds, unit and source."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from rcs.errors import InvalidSetup

VERSION = 1
"""Raised when a layout's numbers come to mean something else."""

LARGEST = float(2.0**127)
"""Bound of a number in a vector, where its key has none: what float32 holds."""

Path = tuple[str, ...]
"""Keys from the outermost to the innermost, such as ("privileged", "cuboid", "tquat")."""

Kind = Literal["value", "turn", "offset", "near", "relative_turn", "half_turn"]
"""What an entry has of its key.

- `value`: numbers of the key, (number - offset) / scale.
- `turn`: the rotation of a pose, as the first two columns of its matrix, which have no jumps (Zhou et al. 2019,
  arXiv:1812.07035).
- `offset`: the way d from one pose to another, in the axes of the base (of several robots: the scene): d / scale.
- `near`: the same, for the last centimetres, along each axis: d / sqrt(d² + scale²), within -1 and 1.
- `relative_turn`: the rotation of the other pose in the frame of the first, as columns.
- `half_turn`: how the other pose's x axis is turned about the z axis of the first, as cosine and sine of twice the
  angle: a gripper fits a box that is turned by half a turn as well.

All but the first two follow from other numbers; the way back does without them.
"""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """Consecutive numbers of a vector."""

    path: Path
    """The key; of pairs, that of the pose from which is measured."""
    kind: Kind = "value"
    """What the numbers are."""
    to: Path = ()
    """Of pairs, the key of the pose to which is measured."""
    place: tuple[int, int]
    """First number in the vector, and the one after the last."""
    picked: tuple[int, int] = (0, 0)
    """Of a `value`, which numbers of the key, the first and the one after the last; rows of arrays one after the other.
    """
    shape: tuple[int, ...]
    """Shape of the key."""
    dtype: str
    """Type of the key's numbers, such as `float64`."""
    offset: tuple[float, ...]
    """What is 0 in the vector, in the key's unit."""
    scale: tuple[float, ...]
    """What is 1 more in the vector, in the key's unit."""
    low: tuple[float, ...]
    """Lower bounds in the vector."""
    high: tuple[float, ...]
    """Upper bounds in the vector."""
    rest: tuple[float, ...] = ()
    """Of an action of which the vector has not all numbers, the value of the whole key, for the others."""
    unit: str = ""
    """Unit of offset and scale."""
    source: str = ""
    """Where offset and scale come from."""

    @property
    def name(self) -> str:
        """The key with slashes, such as `privileged/cuboid/tquat`."""
        return "/".join(self.path) + (f" to {'/'.join(self.to)}" if self.to else "")

    @property
    def slice(self) -> slice:
        """Its place in the vector."""
        return slice(*self.place)


@dataclass(frozen=True, kw_only=True)
class Image:
    """A camera's frame: uint8, channels before rows before columns."""

    path: Path
    """The key."""
    name: str
    """Its name in the flat observation."""
    shape: tuple[int, int, int]
    """Channels, height and width."""
    is_depth: bool = False
    """Whether it is depth, of which one level is `level_mm`; 0 has no reading and 255 is that far or farther."""
    level_mm: int = 1
    """Depth of one level [mm]."""


@dataclass(frozen=True, kw_only=True)
class FlatLayout:
    """How dictionaries and vectors correspond. `to_json` and `from_json` are inverse to each other, exactly."""

    action: tuple[Entry, ...]
    """Entries of the action's vector."""
    state: tuple[Entry, ...]
    """Entries of the observation's vector."""
    images: tuple[Image, ...] = ()
    """Cameras' frames."""
    bases: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    """Of several robots, the poses of their bases in the scene by name, (7,) [m], xyzw."""

    @property
    def action_size(self) -> int:
        """Numbers of an action."""
        return self.action[-1].place[1] if self.action else 0

    @property
    def state_size(self) -> int:
        """Numbers of an observation."""
        return self.state[-1].place[1] if self.state else 0

    def to_json(self) -> dict[str, Any]:
        """Return the layout as JSON values."""
        return {"version": VERSION, **json.loads(json.dumps(dataclasses.asdict(self), allow_nan=False))}

    @staticmethod
    def from_json(values: Any) -> FlatLayout:
        """Return the layout that `to_json` wrote.

        Raises:
            InvalidSetup: The values are not those of a layout, or of another version.
        """
        if not isinstance(values, Mapping) or values.get("version") != VERSION:
            found = values.get("version") if isinstance(values, Mapping) else type(values).__name__
            raise InvalidSetup(f"The layout has version {found!r}; this program reads version {VERSION}.")
        try:
            layout = FlatLayout(
                action=tuple(_entry(one) for one in values["action"]),
                state=tuple(_entry(one) for one in values["state"]),
                images=tuple(Image(**_tuples(one)) for one in values["images"]),
                bases={str(name): tuple(map(float, base)) for name, base in values["bases"].items()},
            )
        except (KeyError, TypeError, ValueError, AttributeError) as err:
            raise InvalidSetup(f"The layout is damaged: {type(err).__name__}: {err}.") from err
        for image in layout.images:
            sizes = (*image.shape, image.level_mm)
            if len(sizes) != 4 or not all(isinstance(one, int) and one > 0 for one in sizes):
                raise InvalidSetup(f"The layout is damaged: its image {image.name!r} has the shape {image.shape}.")
        for entries in (layout.action, layout.state):
            end = 0
            for entry in entries:
                end = _check(entry, end)
        return layout

    def __str__(self) -> str:
        """Return a line per entry."""
        lines = ["observation"]
        lines += [_line(entry) for entry in self.state]
        lines += [f"  {'':8}{image.name:66}{'x'.join(map(str, image.shape)):8} uint8" for image in self.images]
        return "\n".join([*lines, "action", *(_line(entry) for entry in self.action)])


def _line(entry: Entry) -> str:
    first, end = entry.place
    offset, scale = (_range(table) for table in (entry.offset, entry.scale))
    what = "" if entry.kind == "value" else f" ({entry.kind.replace('_', ' ')})"
    numbers = f"{first}" if end == first + 1 else f"{first}-{end - 1}"
    formula = f"(value - {offset}) / {scale} {entry.unit}".rstrip()
    return f"  {numbers:8}{entry.name + what:66}{formula}; {entry.source}"


def _range(numbers: Sequence[float]) -> str:
    low, high = min(numbers), max(numbers)
    return f"{low:.3g}" if low == high else f"[{low:.3g} … {high:.3g}]"


def _entry(values: Any) -> Entry:
    return Entry(**_tuples(values))


def _tuples(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, Sequence) and not isinstance(value, str) else value
            for key, value in values.items()}  # fmt: skip


def _check(entry: Entry, first: int) -> int:
    """Check an entry that a file gave, and return where the next one starts."""
    size = entry.place[1] - entry.place[0]
    tables = (entry.offset, entry.scale, entry.low, entry.high)
    is_valid = (
        entry.place[0] == first
        and size > 0
        and all(len(table) == size and all(isinstance(one, float) for one in table) for table in tables)
        and all(one > 0 for one in entry.scale)
        and entry.kind in get_args(Kind)
        and (entry.kind != "value" or entry.picked[1] - entry.picked[0] == size)
    )
    if not is_valid:
        raise InvalidSetup(f"The layout is damaged: its entry {entry.name!r} does not fit its place {entry.place}.")
    return entry.place[1]
