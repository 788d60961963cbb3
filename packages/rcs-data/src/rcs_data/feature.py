"""A feature: one column of a dataset, with its shape, dtype, unit and encoding."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import numpy as np
import pyarrow as pa

from rcs_data.errors import InvalidSetup
from rcs_data.joint_bounds import JointBounds
from rcs_data.text import check_text
from rcs_data.video_format import VideoCodec, pixel_format

Colour = Literal["jpeg", "lossless", "h264", "av1"]
"""Encodings of colour images; the last two are videos."""
Encoding = Literal["plain", "held", "jpeg", "lossless", "h264", "av1", "depth", "labels"]

DTYPES = (
    "bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float32", "float64",
)  # fmt: skip

SIMULATED_TIME = "simulated_time"
"""Key of a simulation's own clock."""

# No action precedes a reset, so these have no value in the first row of an episode.
_EVENTS = ("terminated", "truncated")
_UNKNOWN_AT_RESET = ("action/", "executed/", "reward")
# These may be absent at a reset.
_OPTIONAL_AT_RESET = ("terminated", "truncated", "time/")
# How the recording went, not what was recorded: these differ between otherwise equal runs.
_CIRCUMSTANCES = ("time/", "flags/")
_VIDEOS = get_args(VideoCodec)
_COLOURS = get_args(Colour)
_IMAGES = (*_COLOURS, "depth", "labels")
# Limit per row: an image of 6 000 x 7 000 pixels. A damaged description could claim any size, and memory is allocated.
_MOST_BYTES = 1 << 27
_MOST_AXES = 32
_LONGEST_KEY = 200


@dataclass(frozen=True, kw_only=True)
class Feature:
    """One column of a dataset.

    Raises:
        InvalidSetup: The key, shape, dtype or encoding does not make sense.
    """

    key: str
    """The name, with "/" between its parts: "observation/joints", "observation/frames/wrist/rgb", "time/period"."""
    shape: tuple[int, ...]
    """The shape in one row; () for a single number."""
    dtype: str
    """A numpy dtype name."""
    unit: str = ""
    """The unit in words, such as "rad"; only for people."""
    encoding: Encoding = "plain"
    """How it is stored. "plain": numbers. "held": numbers that rarely change, stored only where they do. "jpeg": an (H,
    W, 3) uint8 image; "lossless": the same without loss; "h264", "av1": the same as a video, of which a complete
    episode has the packets and an open one JPEG. "depth": an (H, W) uint16 image without loss. "labels": the same of
    numbers that name what a pixel shows. Only new images are stored: a row without one has that of the row before."""
    limits: JointBounds | None = None
    """Of joint positions: what these joints can do, with which `check` compares them; None where nobody knows."""

    def __post_init__(self) -> None:
        """Refuse what could not be stored."""
        for name, text in (("key", self.key), ("dtype", self.dtype), ("unit", self.unit)):
            check_text(text, f"The {name} of a feature")
        self._check_key()
        self._check_shape()
        if self.dtype not in DTYPES:
            raise InvalidSetup(f"Feature {self.key!r} has dtype {self.dtype!r}; valid are {', '.join(DTYPES)}.")
        if self.size * self.numpy_dtype.itemsize > _MOST_BYTES:
            raise InvalidSetup(
                f"Feature {self.key!r} is {self._form}, which is more than {_MOST_BYTES >> 20} MB per row."
            )
        if self.encoding not in get_args(Encoding):
            raise InvalidSetup(
                f"Feature {self.key!r} has encoding {self.encoding!r}; valid are {', '.join(get_args(Encoding))}."
            )
        is_colour = self.dtype == "uint8" and len(self.shape) == 3 and self.shape[2] == 3
        if self.colour is not None and not is_colour:
            raise InvalidSetup(f"Feature {self.key!r} is a colour image and must be (H, W, 3) uint8, not {self._form}.")
        if self.video is not None:
            pixel_format(self.shape[0], self.shape[1], self.video)
        if self.encoding in ("depth", "labels") and (self.dtype != "uint16" or len(self.shape) != 2):
            raise InvalidSetup(
                f"Feature {self.key!r} is an image of {self.encoding} and must be (H, W) uint16, not {self._form}."
            )
        if self.is_time and (self.dtype != "float64" or self.shape != ()):
            raise InvalidSetup(f"Feature {self.key!r} is a time and must be a single float64, not {self._form}.")
        if self.is_flags and (self.dtype != "uint8" or self.shape != () or self.encoding != "plain"):
            raise InvalidSetup(f"Feature {self.key!r} has flags and must be a single plain uint8, not {self._form}.")
        if self.encoding == "held" and (self.is_unknown_at_reset or self.is_time or self.key in _EVENTS):
            raise InvalidSetup(
                f"Feature {self.key!r} happens in each row anew, and must be plain; held is for what lasts, such as a "
                "camera's matrices."
            )
        if self.limits is not None and self.shape != (len(self.limits.names),):
            raise InvalidSetup(
                f"Feature {self.key!r} is {self._form} and has limits of {len(self.limits.names)} joints."
            )

    def _check_key(self) -> None:
        words = self.key.split("/")
        # Exports use these words as folders' names.
        if not all(word and word not in (".", "..") and word.isprintable() and "\\" not in word for word in words):
            raise InvalidSetup(
                f"A feature's key must be words of printable text with '/' between them, not {self.key!r}."
            )
        if len(self.key.encode()) > _LONGEST_KEY:
            raise InvalidSetup(f"A feature's key must have at most {_LONGEST_KEY} bytes, not {len(self.key.encode())}.")

    def _check_shape(self) -> None:
        given: Any = self.shape
        is_shape = isinstance(given, tuple | list) and all(
            isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= 1 for n in given
        )
        if not is_shape or len(given) > _MOST_AXES:
            raise InvalidSetup(
                f"Feature {self.key!r} has shape {given!r}; valid are up to {_MOST_AXES} whole numbers of at least 1."
            )
        object.__setattr__(self, "shape", tuple(int(n) for n in given))

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
    def video(self) -> VideoCodec | None:
        """The codec of the video that the images of a complete episode are; None if they are single files."""
        return next((codec for codec in _VIDEOS if codec == self.encoding), None)

    @property
    def can_be_held(self) -> bool:
        """Whether a row without a value repeats the row before."""
        return self.is_image or self.encoding == "held"

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
        """The Arrow field, with shape, dtype, unit and encoding, so that a file can be read on its own."""
        shape = ",".join(str(n) for n in self.shape)
        about = {"shape": shape, "dtype": self.dtype, "unit": self.unit, "encoding": self.encoding}
        return pa.field(self.key, self.arrow_type, metadata=about)

    @property
    def _form(self) -> str:
        return f"{self.shape} {self.dtype}"

    def to_json(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        values = {**asdict(self), "shape": list(self.shape)}
        if self.limits is None:
            del values["limits"]
        return values

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Feature:
        """Build a feature from what `to_json` returned.

        Raises:
            InvalidSetup: A field is missing, unknown or does not make sense.
        """
        try:
            fields: dict[str, Any] = {**values, "shape": tuple(values["shape"])}
            if "limits" in fields:
                fields["limits"] = JointBounds.from_json(fields["limits"])
            return cls(**fields)
        except (KeyError, TypeError, ValueError, AttributeError) as err:
            if isinstance(err, InvalidSetup):
                raise
            raise InvalidSetup(f"Not a description of a feature: {values!r:.200}.") from err
