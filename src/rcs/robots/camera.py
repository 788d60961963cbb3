"""Cameras: descriptions with the formats in which they stream, their calibration, and where they are fixed."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rcs_data.options import Meta, NotNegative, Positive, Record, Whole, converted

from rcs.devices import lookup
from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.description import Description
from rcs.robots.mount import Mount
from rcs.spatial import Intrinsics, Pose

Matrix = tuple[tuple[float, ...], ...]


class ResolutionMode(Record, kw_only=False):
    """One colour format of a camera."""

    width: Whole
    """Pixels."""
    height: Whole
    """Pixels."""
    rates: tuple[Whole, ...]
    """Frame rates to choose from, ascending [frames/s]."""

    def __post_init__(self) -> None:
        """Check the figures.

        Raises:
            InvalidSetup: A size or rate is not positive, there is no rate, or rates do not ascend.
        """
        super().__post_init__()
        if not self.rates or any(a >= b for a, b in zip(self.rates, self.rates[1:], strict=False)):
            raise InvalidSetup(f"rates is {self.rates}; valid are ascending rates, at least one.")

    @property
    def name(self) -> str:
        """Its name, such as `848x480`."""
        return f"{self.width}x{self.height}"

    def __str__(self) -> str:
        """Return size and rates in words."""
        return f"{self.name} at {', '.join(map(str, self.rates))} Hz"


def parse_mode(name: str) -> tuple[int, int] | None:
    """Return width and height [px] of a mode's name; None if it is not of the form `848x480`."""
    width, _, height = name.partition("x")
    if not (name.isascii() and width.isdecimal() and height.isdecimal()):
        return None
    return int(width), int(height)


class CameraDescription(Description):
    """One colour camera, with or without depth; setups decide where it is mounted.

    The frame of the base body is the optical frame of the colour sensor: x right, y down, z forward (OpenCV axes). A
    calibrated pose is therefore the pose of the body.
    """

    camera: str
    """Name of the camera element."""
    mount_hole_in_optical: Mount
    """Pose of the tripod hole in the optical frame; its x axis points along the view, its z axis into the housing."""
    modes: tuple[ResolutionMode, ...]
    """Colour formats with their frame rates."""
    fovy: Annotated[float, Meta(gt=0, lt=math.pi)]
    """Vertical field of view of the colour image [rad], at the native aspect ratio."""
    native_aspect: Positive
    """Width over height of the sensor's own format."""
    has_depth: bool
    """Whether the camera measures depth."""
    depth_range: tuple[float, float]
    """Nearest and farthest depth with useful accuracy [m]; (0, 0) without depth."""
    min_depth: tuple[tuple[int, int, float], ...]
    """Nearest depth by depth format: width [px], height [px], depth [m]."""
    stereo_baseline: float = 0.05
    """Distance between the two eyes of a depth camera [m]; depth noise grows as depth squared over it."""
    stereo_fovx: float = 0.0
    """Horizontal field of view of the eyes [rad]; what the right one does not see has no depth. 0 if it is unknown."""
    longest_exposure: NotNegative = 0.0
    """Longest exposure for which the camera slows down [s]; if it exceeds the frame period, intervals vary between the
    two. 0 for a camera that keeps its rate."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            InvalidSetup: There is no mode or a name is used twice, the field of view is outside of 0 .. pi, an exposure
                is negative, or the depth range does not ascend.
        """
        super().__post_init__()
        if not self.modes or len({mode.name for mode in self.modes}) != len(self.modes):
            raise InvalidSetup(f"{self.name}: modes needs at least one, all of different sizes, got {self.modes}.")
        near, far = self.depth_range
        if self.has_depth and not 0.0 < near < far:
            raise InvalidSetup(f"{self.name}: depth_range {self.depth_range} m must ascend from above 0.")

    def mode(self, name: str) -> ResolutionMode:
        """Return the mode with a name such as `848x480`.

        Raises:
            UnknownName: There is no such mode; the message lists all.
        """
        for mode in self.modes:
            if mode.name == name:
                return mode
        raise UnknownName(f"mode of {self.name}", name, [mode.name for mode in self.modes])

    def frame_rate(self, size: tuple[int, int], wanted: float | None = None) -> int:
        """Return the rate at which the camera delivers frames of a size [frames/s].

        A size that is not a mode is cropped and scaled from a larger one, so it may have the rate of any larger mode; a
        size larger than all modes has the rates of the largest.

        Args:
            size: Width and height [px].
            wanted: The wanted rate [frames/s]; None for the highest.

        Raises:
            InvalidSetup: The camera does not offer it; the message lists all modes.
        """
        fitting = [mode for mode in self.modes if (mode.width, mode.height) == size]
        fitting = fitting or [mode for mode in self.modes if mode.width >= size[0] and mode.height >= size[1]]
        fitting = fitting or [max(self.modes, key=lambda mode: mode.width * mode.height)]
        rates = sorted({rate for mode in fitting for rate in mode.rates})
        if wanted is None:
            return rates[-1]
        for rate in rates:
            if math.isclose(rate, wanted):
                return rate
        raise InvalidSetup(
            f"{self.name} does not deliver {wanted:g} frames/s of {size[0]} x {size[1]} px; it has "
            f"{', '.join(map(str, rates))} for that size. Its modes: {'; '.join(map(str, self.modes))}."
        )

    def intrinsics(self, width: int, height: int) -> NDArray[np.float64]:
        """Return the camera matrix of an ideal image of this camera, without distortion.

        Pixels are square and the principal point is the image's centre. Every format shows the sensor's full height;
        narrower ones lose the sides. This matches MuJoCo for the same `fovy`, and the camera's own 16:9 and 4:3 colour
        formats.

        Args:
            width: Width of the image [px].
            height: Height of the image [px].

        Returns:
            Camera matrix [px], shape (3, 3); the centre of the top left pixel is (0, 0), as in OpenCV.

        Raises:
            InvalidSetup: A size is not positive, or the image is wider than the sensor.
        """
        if width <= 0 or height <= 0:
            raise InvalidSetup(f"{self.name}: image size is {width} x {height} px; both must be positive.")
        # One pixel of slack: 854 x 480 and other rounded 16:9 formats are not wider than the sensor.
        if width > self.native_aspect * height + 1.0:
            widest = int(self.native_aspect * height)
            raise InvalidSetup(
                f"{self.name}: {width} x {height} px is wider than the sensor; {height} px of height allow {widest} px."
            )
        focal = 0.5 * height / math.tan(0.5 * self.fovy)
        return np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])


def _covariance(given: Matrix | None) -> Matrix | None:
    if given is None:
        return None
    matrix = np.asarray(given, np.float64)
    if matrix.shape != (6, 6) or not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T, rtol=1e-6, atol=0):
        raise InvalidSetup(f"It is {given!r}; valid is a symmetric matrix of 6 x 6 finite numbers.")
    if np.linalg.eigvalsh(matrix).min() < -1e-9 * max(np.trace(matrix), 0.0):
        raise InvalidSetup("It has a negative variance along some direction.")
    return given


class Calibration(Record):
    """Where a camera is, how it sees, and how certain that is."""

    optical: Mount | None = None
    """Pose of the optical frame (x right, y down, z forward) in the frame that carries the camera; None for where the
    lab has it."""
    intrinsics: Intrinsics | None = None
    """Focal lengths, principal point and distortion; None for those of the data sheet."""
    pose_covariance: Matrix | None = converted(converter=_covariance, default=None)
    """Covariance of the pose, 6 x 6: translation [m], rotation vector [rad], in the camera's optical frame. It is kept
    with recordings and changes no picture; None if it is not known."""
    sha256: str = ""
    """Hash of the file that this is from; empty for none."""

    def about(self) -> dict[str, Any]:
        """Return the entry of a recording, as JSON values."""
        about: dict[str, Any] = {"source": "calibration"}
        if self.intrinsics is not None:
            about |= describe(self.intrinsics)
        if self.pose_covariance is not None:
            about["pose_covariance"] = [list(row) for row in self.pose_covariance]
        if self.sha256:
            about["sha256"] = self.sha256
        return about


def describe(intrinsics: Intrinsics) -> dict[str, Any]:
    """Return intrinsics as JSON values: `size` [px], `matrix` [px], `distortion` (k1, k2, p1, p2, k3)."""
    return {
        "size": [intrinsics.width, intrinsics.height],
        "matrix": intrinsics.matrix.tolist(),
        "distortion": list(intrinsics.distortion),
    }


def _camera(given: str | CameraDescription) -> str:
    return lookup.name_of("camera", given)


class CameraMount(Record):
    """A camera and where it is fixed."""

    camera: str = converted(converter=_camera)
    """Name of the camera's description, `module:NAME`, or the description itself."""
    optical: Mount
    """Pose of the optical frame (x right, y down, z forward) in the parent's frame."""
    on_gripper_of: str | None = None
    """Name of the robot whose gripper's base body is the parent; None for the scene."""
    calibration: Calibration | None = None
    """Calibrated intrinsics and pose covariance; None for the data sheet's."""


def looking(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Mount:
    """Return the mount of an optical frame at `eye` that looks at `target`, both in the parent's frame [m].

    Args:
        eye: Position of the camera.
        target: A point in the middle of the picture.
        up: Direction that is up in the picture.
    """
    forward = np.subtract(target, eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, np.float64))
    right = right / np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    x, y, z, w = Pose.from_matrix(matrix).quaternion
    ex, ey, ez = np.asarray(eye, np.float64)
    return Mount(translation=(float(ex), float(ey), float(ez)), quaternion=(float(x), float(y), float(z), float(w)))
