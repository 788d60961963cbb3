"""The cameras of a setup: which there are, and what their frames have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from rcs_data.options import Meta, Positive, Record, converted

from rcs.errors import InvalidSetup
from rcs.robots.camera import CameraMount, parse_mode
from rcs.sim.camera import MAX_SIZE
from rcs.sim.pixels import Pixels

ALL = "all"
"""Stands for all cameras of the robot's lab."""
NONE = "none"
"""Stands for no cameras."""
USUAL_SIZE = (224, 224)
"""Width and height of a frame that no size is given for [px]."""

Edge = Annotated[int, Meta(ge=1, le=MAX_SIZE)]
Size = tuple[Edge, Edge]


def _names(given: str | bool | Sequence[str] | None) -> tuple[str, ...]:
    if isinstance(given, bool) or given is None:
        return (ALL,) if given else ()
    names = (given,) if isinstance(given, str) else given
    return () if tuple(names) == (NONE,) else names  # pyright: ignore[reportReturnType]  checked afterwards


def _sizes(given: int | Sequence[int] | Mapping[str, int | Sequence[int]]) -> Size | Mapping[str, Size]:
    def pair(size: Any) -> Any:
        size = size.item() if isinstance(size, np.generic) else size
        return (size, size) if isinstance(size, int) and not isinstance(size, bool) else size

    return {name: pair(size) for name, size in given.items()} if isinstance(given, Mapping) else pair(given)


def _pixels(given: Pixels | bool | None) -> Pixels | None:
    return (Pixels() if given else None) if isinstance(given, bool) else given


class Cameras(Record):
    """The cameras of a setup: `rcs.Cameras(names=("wrist", "side"), image_size=64, depth=True)`."""

    names: tuple[str, ...] = converted(converter=_names, default=(), kw_only=False)
    """Cameras of the robot's lab, of its model and of `mounts` by name; `all` for those of the lab and of `mounts`.
    More cameras, slower steps."""
    mounts: Mapping[str, CameraMount] = converted(converter=dict[str, CameraMount], default_factory=dict)
    """Cameras of your own by name, or others in the place of those of the lab; each is used, named or not."""
    calibration: str | None = None
    """Calibration file with poses and intrinsics; None for those of the lab."""
    image_size: Size | Mapping[str, Size] = converted(converter=_sizes, default=USUAL_SIZE)
    """Width and height of every frame [px], or of those of some cameras by name, where others have 224 x 224. One
    number makes a square. Sizes other than those of a camera's modes are cropped and scaled."""
    mode: str | None = None
    """Name of a mode that all cameras have, such as `848x480`, instead of a size; see `rcs list --cameras`."""
    fps: Positive | Mapping[str, Positive] | None = None
    """Frames per second of all cameras, or of some by name; None for the highest rate of a camera at this size. One
    slower than `frequency` repeats its last frame until the next is due."""
    depth: bool = False
    """Add depth to frames; costs about a third of a frame's time."""
    segmentation: bool = False
    """Add to simulated frames which instance and which geom each pixel shows; about doubles a frame's time."""
    points: bool = False
    """Add the points that pixels show, in the base frame; needs `depth`."""
    noise: bool = False
    """Draw the noise of real cameras, and in depth the gaps of a stereo camera: shadows of near objects, edges, grazing
    views, darkness. The same state has the same noise."""
    pixels: Pixels | None = converted(converter=_pixels, default=None)
    """Observe channel-first frame stacks of simulated cameras instead of images with camera matrices. True: colour
    without stacking."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidSetup: A field has an invalid value; the message says what is valid.
        """
        super().__post_init__()
        names = self.names
        if len(set(names)) != len(names):
            raise InvalidSetup(f"cameras is {names!r}; names must not repeat.")
        if names != (ALL,):
            names = (*names, *(name for name in self.mounts if name not in names))
        object.__setattr__(self, "names", names)
        if self.points and not self.depth:
            raise InvalidSetup("points is True and depth is False; points come from depth, so give depth=True too.")
        self._check_pixels()
        object.__setattr__(self, "image_size", self._size_of_mode())
        for field, given in (("image_size", self.image_size), ("fps", self.fps)):
            unknown = sorted(set(given) - set(names)) if isinstance(given, Mapping) else []
            if unknown and names != (ALL,):
                raise InvalidSetup(f"{field} names the cameras {unknown}; this setup has {list(names)}.")

    def __bool__(self) -> bool:
        """Return whether there is any camera."""
        return bool(self.names)

    def __iter__(self) -> Iterator[str]:
        """Return an iterator over the names."""
        return iter(self.names)

    @staticmethod
    def of(given: Any) -> Any:
        """Return cameras in the short forms that a setup takes: names, one name, mounts by name, a flag, or JSON.

        Anything else is returned as it is.
        """
        if isinstance(given, Mapping):
            is_mounts = any(isinstance(one, CameraMount) for one in given.values())
            return Cameras(mounts=given) if is_mounts else Cameras.from_json(given)
        if given is None or isinstance(given, str | bool | Sequence):
            return Cameras(names=given)
        return given

    def size_of(self, camera: str) -> tuple[int, int]:
        """Return width and height of a camera's frames [px]."""
        return self.image_size.get(camera, USUAL_SIZE) if isinstance(self.image_size, Mapping) else self.image_size

    def fps_of(self, camera: str) -> float | None:
        """Return the wanted frame rate of a camera [frames/s]; None for its highest."""
        return self.fps.get(camera) if isinstance(self.fps, Mapping) else self.fps

    def _check_pixels(self) -> None:
        if self.pixels is None:
            return
        for name in ("depth", "segmentation", "points", "noise"):
            if getattr(self, name):
                raise InvalidSetup(f"{name} is True and pixels are given, which are colours alone; choose one of them.")
        if isinstance(self.image_size, Mapping) and len({self.size_of(name) for name in self.names}) > 1:
            raise InvalidSetup(
                f"image_size is {self.image_size} and pixels are given; pixels for learners are of one size."
            )

    def _size_of_mode(self) -> Size | Mapping[str, Size]:
        if self.mode is None:
            return self.image_size
        size = parse_mode(self.mode)
        if size is None or not all(1 <= edge <= MAX_SIZE for edge in size):
            if self.names:
                return self.image_size  # refused where the cameras are looked up, with a list of their modes
            raise InvalidSetup(f"mode is {self.mode!r}; it is written like '848x480' (see `rcs list --cameras`).")
        if self.image_size not in (size, USUAL_SIZE):
            raise InvalidSetup(f"mode is {self.mode!r} and image_size is {self.image_size}; give one of the two.")
        return size
