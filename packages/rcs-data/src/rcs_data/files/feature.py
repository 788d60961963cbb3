"""A feature: one column of a dataset, with its shape, dtype, unit, encoding, and ranges of joints."""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

import numpy as np
import pyarrow as pa

from rcs_data.errors import InvalidSetup
from rcs_data.files.text import check_text
from rcs_data.options import Record, Whole

Colour = Literal["jpeg", "lossless"]
"""Encodings of colour images."""
Encoding = Literal["plain", "held", "jpeg", "lossless", "depth", "labels"]
DType = Literal["bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float32", "float64"]
DTYPES = get_args(DType)

NOTES = "notes/"
"""Beginning of the keys of notes beside steps, which not every step has: numbers are then NaN."""
SIMULATED_TIME = "simulated_time"
"""Key of a simulation's own clock."""
EPISODE, STEP = "episode", "step"
"""Columns of `steps.parquet` that say which row this is."""

# No action precedes a reset, so these have no value in the first row of an episode.
_EVENTS = ("terminated", "truncated")
_UNKNOWN_AT_RESET = ("action/", "executed/", "reward")
# These may be absent at a reset.
_OPTIONAL_AT_RESET = ("terminated", "truncated", "time/")
# How the recording went, not what was recorded: these differ between otherwise equal runs.
_CIRCUMSTANCES = ("time/", "flags/")
_COLOURS = get_args(Colour)
_IMAGES = (*_COLOURS, "depth", "labels")
# Limit per row: an image of 6 000 x 7 000 pixels.
_MOST_BYTES = 1 << 27
_LONGEST_KEY = 200


class JointBounds(Record):
    """Ranges and speeds of an arm's joints, with which its recorded positions are checked.

    Raises:
        InvalidSetup: The numbers are not finite, or not one per joint.
    """

    arm: str
    """The arm in words, such as "Franka Research 3"."""
    names: tuple[str, ...]
    """The joints, in the order of the column."""
    lower: tuple[float, ...]
    """Lower ends of their ranges [rad]."""
    upper: tuple[float, ...]
    """Upper ends of their ranges [rad]."""
    velocity: tuple[float, ...]
    """Largest speeds [rad/s]."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        for text in (self.arm, *self.names):
            check_text(text, "A name in joint limits")
        for field in ("lower", "upper", "velocity"):
            if len(getattr(self, field)) != len(self.names):
                raise InvalidSetup(
                    f"Joint limits have {field} {getattr(self, field)}; it must be {len(self.names)} finite numbers, "
                    "one per joint."
                )


class Feature(Record):
    """One column of a dataset.

    Raises:
        InvalidSetup: The key, shape, dtype or encoding does not make sense.
    """

    key: str
    """The name, with "/" between its parts: "observation/joints", "observation/frames/wrist/rgb", "time/period"."""
    shape: tuple[Whole, ...]
    """The shape in one row; () for a single number."""
    dtype: DType
    """A numpy dtype name."""
    unit: str = ""
    """The unit in words, such as "rad"; only for people."""
    encoding: Encoding = "plain"
    """How it is stored. "plain": numbers. "held": numbers that rarely change, which then take no space. "jpeg": an (H,
    W, 3) uint8 image; "lossless": the same without loss. "depth": an (H, W) uint16 image without loss. "labels": the
    same of numbers that name what a pixel shows. Only new images are stored: a row without one has that of the row
    before."""
    limits: JointBounds | None = None
    """Bounds of the joints, for a feature of joint positions, with which `check` compares them; None where nobody
    knows."""
    words: tuple[str, ...] = ()
    """The words that the numbers stand for: 1 is the first, 0 is none; empty for plain numbers."""

    def __post_init__(self) -> None:
        """Refuse what could not be stored."""
        super().__post_init__()
        for name, text in (("key", self.key), ("unit", self.unit), *(("word", word) for word in self.words)):
            check_text(text, f"The {name} of a feature")
        self._check_key()
        is_colour = self.dtype == "uint8" and len(self.shape) == 3 and self.shape[2] == 3
        is_plane = self.dtype == "uint16" and len(self.shape) == 2
        is_single = self.shape == () and self.encoding == "plain"
        for is_wrong, needs in (
            (self.size * self.numpy_dtype.itemsize > _MOST_BYTES, f"take at most {_MOST_BYTES >> 20} MB per row"),
            (self.colour is not None and not is_colour, "be (H, W, 3) uint8, as a colour image"),
            (
                self.encoding in ("depth", "labels") and not is_plane,
                f"be (H, W) uint16, as an image of {self.encoding}",
            ),
            (self.is_time and (self.dtype != "float64" or self.shape != ()), "be a single float64, as a time"),
            (self.is_flags and not (self.dtype == "uint8" and is_single), "be a single plain uint8, as it has flags"),
            (
                bool(self.words) and not (self.dtype == "uint8" and is_single),
                "be a single plain uint8, as it is a word",
            ),
            (
                self.encoding == "held" and (self.is_unknown_at_reset or self.is_time or self.key in _EVENTS),
                "be plain, as it happens in each row anew; held is for what lasts, such as a camera's matrices",
            ),
            (
                self.limits is not None and self.shape != (len(self.limits.names),),
                f"have one number per joint, as it has limits of {len(self.limits.names) if self.limits else 0} joints",
            ),
        ):
            if is_wrong:
                raise InvalidSetup(f"Feature {self.key!r} is {self.shape} {self.dtype} and must {needs}.")

    def _check_key(self) -> None:
        words = self.key.split("/")
        # Exports use these words as folders' names.
        if not all(word and word not in (".", "..") and word.isprintable() and "\\" not in word for word in words):
            raise InvalidSetup(
                f"A feature's key must be words of printable text with '/' between them, not {self.key!r}."
            )
        if len(self.key.encode()) > _LONGEST_KEY:
            raise InvalidSetup(f"A feature's key must have at most {_LONGEST_KEY} bytes, not {len(self.key.encode())}.")
        if self.key in (EPISODE, STEP):
            raise InvalidSetup(f"{self.key!r} cannot be a feature: it is a column of every dataset.")

    @property
    def is_time(self) -> bool:
        """Whether this is a time, which may be unknown in a row."""
        return self.key.startswith("time/") or self.key == SIMULATED_TIME

    @property
    def is_flags(self) -> bool:
        """Whether this holds a camera's flags, a `FrameFlag` in each row."""
        return self.key.startswith("flags/")

    @property
    def is_circumstance(self) -> bool:
        """Whether this says how the recording went, and so differs between otherwise equal runs."""
        return self.key.startswith(_CIRCUMSTANCES)

    @property
    def is_image(self) -> bool:
        """Whether this is stored as the bytes of an image."""
        return self.encoding in _IMAGES

    @property
    def colour(self) -> Colour | None:
        """The encoding, if this is a colour image."""
        return next((encoding for encoding in _COLOURS if encoding == self.encoding), None)

    @property
    def is_unknown_at_reset(self) -> bool:
        """Whether the first row of an episode has no value here, because no action precedes it."""
        return self.key.startswith(_UNKNOWN_AT_RESET)

    @property
    def is_optional_at_reset(self) -> bool:
        """Whether the first row of an episode may leave this out."""
        return self.key.startswith(_OPTIONAL_AT_RESET)

    @property
    def size(self) -> int:
        """Numbers per row."""
        return math.prod(self.shape)

    @property
    def numpy_dtype(self) -> np.dtype[Any]:
        """The numpy dtype."""
        return np.dtype(self.dtype)

    @property
    def arrow_type(self) -> pa.DataType:
        """The Arrow type of the column: a number, a list of fixed length (row-major), or the bytes of an image."""
        if self.is_image:
            return pa.binary()
        number = pa.from_numpy_dtype(self.numpy_dtype)
        return number if self.shape == () else pa.list_(number, self.size)

    @property
    def arrow_field(self) -> pa.Field:
        """The Arrow field."""
        return pa.field(self.key, self.arrow_type)
