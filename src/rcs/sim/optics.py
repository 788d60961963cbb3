"""Camera matrices, distortion and lens of a simulated camera."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs._core import Lens
from rcs.errors import InvalidSetup
from rcs.sim.scene import CameraPlacement
from rcs.spatial.pinhole import COEFFICIENTS, Intrinsics, pixel_rays

LARGEST_CANVAS = 4096
"""Largest edge of the canvas from which a distorted picture is made [px]."""

_SAME = 1e-9

_POWERS = np.array([2.0, 4.0, 1.0, 1.0, 6.0])
# Powers of the focal length that go with k1, k2, p1, p2, k3.


class Optics:
    """Optics of one camera for pictures of one size.

    An uncalibrated camera has square pixels, its principal point in the middle, and the field of view of the model. A
    calibrated one has the intrinsics of its calibration, cut to the size. A distorted picture is looked up, pixel by
    pixel, in one that is drawn without distortion: colours between the four nearest pixels, depth and segmentation
    from the nearest one, which is off by up to half a pixel.
    """

    def __init__(self, placement: CameraPlacement, size: tuple[int, int], model: mujoco.MjModel) -> None:
        """Prepare the lens.

        Args:
            placement: The camera with its calibration.
            size: Width and height of the pictures [px].
            model: The model of its scene, with the nominal field of view.

        Raises:
            InvalidSetup: The picture of a distorted lens cannot be drawn; the message says why.
        """
        self.id: int = model.camera(placement.camera_name).id
        """Id of the camera in the model."""
        self._size = size
        calibrated = None if placement.calibration is None else placement.calibration.intrinsics
        self.lens: Lens | None = None
        """Lens of the renderer; None for a camera that the model describes."""
        self.canvas = size
        """Width and height of the picture before the lens distorts it [px]."""
        self._scale = (1.0, 1.0)
        self._principal = ((size[0] - 1) / 2, (size[1] - 1) / 2)
        self._distortion = np.zeros(COEFFICIENTS)
        self._focal = float(self._model_focal(model.cam_fovy[self.id]))
        if calibrated is None:
            return
        cut = calibrated.cut(size)
        offsets = (
            cut.fx / self._focal - 1,
            cut.fy / self._focal - 1,
            cut.cx - self._principal[0],
            cut.cy - self._principal[1],
        )
        if not cut.is_distorted and np.abs(offsets).max() < _SAME:
            return  # as the model draws it
        self._scale = (cut.fx / self._focal, cut.fy / self._focal)
        self._principal = (cut.cx, cut.cy)
        self._distortion = np.array(cut.distortion)
        try:
            self.lens = self._distorted(cut) if cut.is_distorted else self._plain(cut)
        except InvalidSetup as err:
            raise InvalidSetup(f"Camera {placement.name!r}: {err}") from err

    def intrinsics(self, fovy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return camera matrices [px], (*leading, 3, 3).

        Args:
            fovy: Present vertical field of view in the model [degrees], (*leading).
        """
        focal = self._model_focal(fovy)
        matrices = np.zeros((*np.shape(focal), 3, 3))
        matrices[..., 0, 0], matrices[..., 1, 1] = self._scale[0] * focal, self._scale[1] * focal
        # The centre of the top left pixel is (0, 0), as in OpenCV.
        matrices[..., 0, 2], matrices[..., 1, 2] = self._principal
        matrices[..., 2, 2] = 1.0
        return matrices

    def distortion(self, fovy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return k1, k2, p1, p2, k3, (*leading, 5).

        A randomised field of view moves the same lens to or from the sensor: pixels stay where the lens puts them, and
        the coefficients are those for the other focal length.

        Args:
            fovy: Present vertical field of view in the model [degrees], (*leading).
        """
        longer = np.asarray(self._model_focal(fovy) / self._focal)
        return self._distortion * longer[..., None] ** _POWERS

    def _model_focal(self, fovy: NDArray[np.float64]) -> NDArray[np.float64]:
        return 0.5 * self._size[1] / np.tan(0.5 * np.deg2rad(fovy))

    def _plain(self, cut: Intrinsics) -> Lens:
        width, height = self._size
        return Lens(scale_x=self._scale[0], scale_y=self._scale[1], cx=cut.cx, cy=cut.cy, width=width, height=height)

    def _distorted(self, cut: Intrinsics) -> Lens:
        lookup = pixel_rays(cut.matrix, self._size, cut.distortion) * (cut.fx, cut.fy) + (cut.cx, cut.cy)
        first = np.floor(lookup.min(axis=(0, 1)))
        width, height = (int(edge) for edge in np.ceil(lookup.max(axis=(0, 1))) - first + 1)
        if max(width, height) > LARGEST_CANVAS:
            raise InvalidSetup(
                f"without distortion its picture has {width} x {height} px; drawn are up to {LARGEST_CANVAS} px, so "
                "choose a smaller image_size, or a lens that sees less."
            )
        self.canvas = width, height
        return Lens(
            scale_x=self._scale[0],
            scale_y=self._scale[1],
            cx=cut.cx - first[0],
            cy=cut.cy - first[1],
            width=width,
            height=height,
            lookup=np.ascontiguousarray(lookup - first, np.float32),
        )
