"""Frames of a tactile sensor drawn by Tacto 0.0.3 (extra `tacto`), to compare with or to train on.

RCS computes the gel's surface, so any object of a scene can be felt; Tacto draws it with its own lights, materials and
OpenGL context. Without a GPU it takes 50 to 130 ms a frame, `gel` about 1 ms.
"""

from __future__ import annotations

import collections
import collections.abc
import fractions
import importlib
import math
import os
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs._core import probe_gl
from rcs.errors import InvalidSetup, MissingDependency
from rcs.robots.tactile import TactileDescription
from rcs.sim.gel import Gel, GelImage, Image

MESH_ROWS = 160
"""Vertices of the surface along the sensor's z axis; twice as many take four times as long and look the same."""


class Tacto:
    """Tacto's renderer with its figures of the DIGIT."""

    def __init__(self, sensor: TactileDescription, gel: Gel) -> None:
        """Import Tacto; its scene is created by the first drawing.

        Args:
            sensor: A DIGIT.
            gel: Its gel.

        Raises:
            InvalidSetup: Tacto has no figures of the sensor.
            MissingDependency: Tacto is not installed.
        """
        if sensor.name != "digit":
            raise InvalidSetup(f"Tacto supports only the sensor 'digit', not {sensor.name!r}.")
        self._tacto = _import_tacto()
        self._renderer: Any = None
        self._gel = gel
        _, y0, z0 = sensor.camera_position
        self._front = sensor.gel_center[0] - sensor.camera_position[0]
        columns = int(MESH_ROWS * sensor.gel_width / sensor.gel_height)
        y = sensor.gel_center[1] - y0 + sensor.gel_width * np.linspace(-0.5, 0.5, columns)
        z = sensor.gel_center[2] - z0 + sensor.gel_height * np.linspace(-0.5, 0.5, MESH_ROWS)
        self._y, self._z = np.meshgrid(y, z)

    def draw(self, displacement: Image) -> GelImage:
        """Return the frame of a displacement, (height, width, 3).

        Raises:
            MissingDependency: Tacto's packages cannot draw here.
        """
        if self._renderer is None:
            width, height = self._gel.size
            try:
                # Tacto's frames stand upright: its rows run along -z.
                self._renderer = self._tacto.Renderer(height, width, None, self._tacto.get_digit_config_path())
            except ImportError as err:
                raise MissingDependency(_remedy(err)) from err
        recess = self._front - self.surface(displacement)
        frame, _ = self._renderer.render_from_depth(recess, noise=False, calibration=False)
        # From rows along -z and columns along -y to rows along -y and columns along +z.
        return np.ascontiguousarray(frame[::-1, :, :3].transpose(1, 0, 2))

    def surface(self, displacement: Image) -> NDArray[np.float64]:
        """Return the depth of the gel's surface on Tacto's grid: rows along z, columns along y [m]."""
        depth = self._gel.rest - displacement
        found = np.full(self._y.shape, self._front)
        # A ray's hit depends on the depth there; each round halves the error or better.
        for _ in range(12):
            found = _sample(depth, *self._gel.pixels(self._y / found, self._z / found))
        return found

    def close(self) -> None:
        """Free Tacto's OpenGL context. Closing twice is harmless; drawing again makes a new one."""
        if self._renderer is not None:
            self._renderer.r.delete()
            self._renderer = None


def _sample(image: Image, rows: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return an image's values between its pixels; edge values continue beyond the edge."""
    rows = np.clip(rows, 0.0, image.shape[0] - 1.001)
    columns = np.clip(columns, 0.0, image.shape[1] - 1.001)
    row, column = rows.astype(np.intp), columns.astype(np.intp)
    down, right = rows - row, columns - column
    upper = (1.0 - right) * image[row, column] + right * image[row, column + 1]
    lower = (1.0 - right) * image[row + 1, column] + right * image[row + 1, column + 1]
    return (1.0 - down) * upper + down * lower


def _import_tacto() -> Any:
    """Import Tacto.

    Raises:
        MissingDependency: It is not installed, or a package that it needs does not work here.
    """
    # Without it, Tacto's OpenGL needs a display. An earlier choice stays.
    if "PYOPENGL_PLATFORM" not in os.environ:
        usable = [probe.name for probe in probe_gl() if probe.ok]
        if usable:
            os.environ["PYOPENGL_PLATFORM"] = usable[0]
    try:
        with _names_of_2018():
            return importlib.import_module("tacto")
    except (ImportError, AttributeError) as err:
        raise MissingDependency(_remedy(err)) from err


def _remedy(err: Exception) -> str:
    return (
        f"look='tacto' needs Tacto, which does not work here ({err}); pip install 'robot-control-stack[tacto]', and "
        "for OSMesa, for which the PyOpenGL that comes with it is too old, pip install -U --no-deps networkx PyOpenGL."
    )


@contextmanager
def _names_of_2018() -> Generator[None]:
    """Restore names that Python and NumPy have dropped while Tacto is being imported.

    Tacto's packages are pinned to networkx 2.2, which needs them at import only.
    """
    lent: list[tuple[Any, str]] = []
    wanted: list[tuple[Any, str, Any]] = [
        *((collections, name, getattr(collections.abc, name)) for name in collections.abc.__all__),
        (fractions, "gcd", math.gcd),
        (np, "float_", np.float64),
        (np, "float", float),
        (np, "int", int),
    ]
    for module, name, value in wanted:
        if name not in vars(module):
            setattr(module, name, value)
            lent.append((module, name))
    try:
        yield
    finally:
        for module, name in lent:
            delattr(module, name)
